// Drives the controller for tests.
//
//   drive FILE bundle|model < ticks > answers
//   drive load FILE...                 prints what is wrong with each file, or "loaded"
//
// A tick is 36 doubles: whether there are a measurement (1) and a command (2), or a reset
// (4); now; 30 measured values and their time; the command. An answer is 26 doubles:
// position, velocity, thread CPU time of the tick (s), allocations in it; then 16 letters
// of the fault's name and 16 of its joint's.
#include <ctime>
#include <new>

#include "bp2_controller.hpp"

static long allocations = 0;
void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  std::abort();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }

static double cpu_time() {
  timespec time{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

int main(int argc, char** argv) {
  std::string wrong;
  if (argc > 2 && std::string(argv[1]) == "load") {
    for (int i = 2; i < argc; ++i) {
      const auto controller = bp2::Controller::load(argv[i], wrong);
      const double command[3] = {1.0, 0.1, 0.1};
      for (int k = 0; controller && k < 60; ++k) {
        const double now = 0.005 * k;
        const bp2::Measurement measurement{{}, {}, {1e-9 * k, 0.0, 1.0}, {}, now};
        controller->step(&measurement, command, now);
      }
      std::puts(controller ? "loaded" : wrong.c_str());
    }
    return 0;
  }
  if (argc != 3) return 2;
  const bool model = std::string(argv[2]) == "model";
  const auto controller = bp2::Controller::load(argv[1], wrong, model ? bp2::Convention::model : bp2::Convention::bundle);
  if (!controller) {
    std::fprintf(stderr, "%s\n", wrong.c_str());
    return 1;
  }
  double tick[36];
  while (std::fread(tick, sizeof tick, 1, stdin) == 1) {
    const int told = static_cast<int>(tick[0]);
    if (told & 4) controller->reset();
    bp2::Measurement measurement;
    std::memcpy(&measurement, tick + 2, sizeof measurement);
    const long before = allocations;
    const double start = cpu_time();
    const bp2::Targets targets = controller->step(told & 1 ? &measurement : nullptr, told & 2 ? tick + 33 : nullptr, tick[1]);
    struct {
      bp2::Targets targets;
      double cpu, allocated;
      char fault[16], joint[16];
    } answer{targets, cpu_time() - start, static_cast<double>(allocations - before), {}, {}};
    std::strncpy(answer.fault, controller->fault(), 15);
    std::strncpy(answer.joint, controller->fault_joint(), 15);
    std::fwrite(&answer, sizeof answer, 1, stdout);
  }
}
