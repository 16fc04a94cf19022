// A 200 Hz loop around the controller that talks to the rehearsal over UDP. On a robot,
// put the drives' and the IMU's interface in the place of the socket.
//
//   cmake -B build && cmake --build build
//   python -m onboard.rehearse --program cpp/build/controller     # in the bundle's folder
//
// It prints its port, or what is wrong with the file; at SIGTERM, a line of JSON about its
// ticks.
#include <arpa/inet.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <csignal>
#include <ctime>

#include "bp2_controller.hpp"

namespace {

constexpr double kTick = 0.005, kGrace = 0.001;  // s; a measurement that is due is waited for
constexpr double kOperatorSilence = 0.5;  // s, after which the operator counts as silent
volatile std::sig_atomic_t running = 1;

double seconds(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

struct Inbox {
  bp2::Measurement measurement{};
  double command[3] = {}, command_time = -bp2::kInfinity;
  bool any = false;

  /// Takes a datagram, a letter and doubles: S and 30 from the sensors, C and 3 from the
  /// operator. Returns whether it is a measurement.
  bool take(const char* bytes, ssize_t size, double now) {
    if (size == 1 + 3 * 8 && bytes[0] == 'C') {
      std::memcpy(command, bytes + 1, sizeof command);
      command_time = now;
    }
    if (size != 1 + 30 * 8 || bytes[0] != 'S') return false;
    std::memcpy(&measurement, bytes + 1, 30 * 8);  // joint angles and speeds, up, gyro
    measurement.time = now;
    return any = true;
  }
};

/// Receives what comes until a measurement is there, or until the deadline.
void receive(int radio, Inbox& inbox, double deadline) {
  char bytes[2048];
  bool measured = false;
  while (running) {
    const ssize_t size = recv(radio, bytes, sizeof bytes, MSG_DONTWAIT);
    if (size >= 0) {
      measured = inbox.take(bytes, size, seconds(CLOCK_MONOTONIC)) || measured;
      continue;
    }
    const double left = deadline - seconds(CLOCK_MONOTONIC);
    if (measured || left <= 0.0) return;
    pollfd waiting{radio, POLLIN, 0};
    const timespec time{0, static_cast<long>(1e9 * left)};
    ppoll(&waiting, 1, &time, nullptr);
  }
}

/// Prints p50, p99 and the greatest of the ticks' times.
void print(const char* name, std::vector<float>& ms) {
  std::sort(ms.begin(), ms.end());
  const std::size_t last = ms.size() - 1;
  std::printf("\"%s\": [%.6f, %.6f, %.6f], ", name, ms[last / 2], ms[last * 99 / 100], ms[last]);
}

}  // namespace

int main(int argc, char** argv) {
  std::string wrong;
  const auto controller = bp2::Controller::load(argc > 1 ? argv[1] : "controller.bin", wrong);
  if (!controller) {
    std::printf("error: %s\n", wrong.c_str());
    return 2;
  }
  for (const int ends : {SIGINT, SIGTERM}) std::signal(ends, [](int) { running = 0; });
  const int radio = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in here{}, there{};
  socklen_t length = sizeof here;
  here.sin_family = AF_INET;
  here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  auto* address = reinterpret_cast<sockaddr*>(&here);
  if (bind(radio, address, length) != 0 || getsockname(radio, address, &length) != 0) return 1;
  std::printf("%d\n", ntohs(here.sin_port));
  std::fflush(stdout);
  // The first to send is the robot; nobody else is heard after it.
  pollfd first{radio, POLLIN, 0};
  while (running && poll(&first, 1, 100) <= 0) continue;
  char byte;
  recvfrom(radio, &byte, 1, MSG_PEEK | MSG_DONTWAIT, reinterpret_cast<sockaddr*>(&there), &length);
  connect(radio, reinterpret_cast<sockaddr*>(&there), length);

  Inbox inbox;
  std::vector<float> wall, cpu;  // ms, of each tick
  wall.reserve(1 << 20);
  cpu.reserve(1 << 20);
  receive(radio, inbox, seconds(CLOCK_MONOTONIC) + kTick);
  while (running) {
    const double now = seconds(CLOCK_MONOTONIC), used = seconds(CLOCK_THREAD_CPUTIME_ID);
    const bool heard = now - inbox.command_time <= kOperatorSilence;
    const bp2::Measurement* measurement = inbox.any ? &inbox.measurement : nullptr;
    const bp2::Targets targets = controller->step(measurement, heard ? inbox.command : nullptr, now);
    char bytes[1 + sizeof targets] = {'T'};
    std::memcpy(bytes + 1, &targets, sizeof targets);
    send(radio, bytes, sizeof bytes, MSG_DONTWAIT);  // what does not get through is lost
    if (wall.size() < wall.capacity()) {
      wall.push_back(static_cast<float>(1e3 * (seconds(CLOCK_MONOTONIC) - now)));
      cpu.push_back(static_cast<float>(1e3 * (seconds(CLOCK_THREAD_CPUTIME_ID) - used)));
    }
    receive(radio, inbox, now + kTick + kGrace);
  }
  if (wall.empty()) return 1;
  std::printf("{\"ticks\": %zu, ", wall.size());
  print("wall_ms", wall);
  print("cpu_ms", cpu);
  const char *fault = controller->fault(), *joint = controller->fault_joint(), *comma = "";
  std::printf("\"fault\": \"%s%s%s\", \"used\": {", fault, *joint ? ": " : "", joint);
  for (std::size_t i = 0; i < bp2::kFaults; ++i)
    if (const double used = controller->used()[i]; used > 0.0) {
      std::printf("%s\"%s\": %.6f", comma, bp2::kFaultNames[i], used);
      comma = ", ";
    }
  std::puts("}}");
}
