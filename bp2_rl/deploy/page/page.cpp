// A robot's controller, motors and operator for a page in a browser, which steps the
// physics in between. `python -m bp2_rl.deploy.page.build` compiles it to page.wasm.
//
// Page and code share the numbers of `Shared`, whose order page.js knows. In each control
// step the page calls `tick` and then, in each of its milliseconds, `drive`; where the
// motors keep to their envelope throughout, `correct` after a trial step, which the page
// takes again where `correct` says so.
#include "bp2_motors.hpp"

#ifdef __wasm__
#define EXPORTED(name) extern "C" __attribute__((export_name(#name)))
#else
#define EXPORTED(name) extern "C" __attribute__((visibility("default")))
#endif

namespace {

constexpr double kTick = 0.005;  // s
constexpr double kOutside = 0.1;  // Nm, beyond the envelope, that is not worth another trial
constexpr std::size_t kIssued = 8, kMilliseconds = 5;

struct Shared {
  double qpos[23], qvel[22], after[22], mobility[12];  // the state, speeds after a trial
  double wish[3], torque[12], force[22], told[3];
} shared;

std::unique_ptr<bp2::Controller> controller;
std::string wrong;

struct Robot {
  std::size_t leg;  // numbers of a leg
  bp2::Motors motors;
  bp2::Operator person;
  bp2::Vector up;
  bp2::Joints stand, stand_torque, before{};
  std::array<double, kMilliseconds> behind;  // how many targets ago in each millisecond
  std::array<bp2::Targets, kIssued> issued{};  // newest first
  double time = 0.0;

  explicit Robot(bp2::detail::File& file)
      : leg((file.size("stand.qpos") - 7) / bp2::kLegs), motors(file), person(file), up(file.array<3>("up")),
        stand(file.array<12>("stand.target")), stand_torque(file.array<12>("stand.torque")),
        behind(file.array<kMilliseconds>("behind")) {
    if (file.size("stand.qpos") != 19 && file.size("stand.qpos") != 23) file.blame("is of a robot with other legs");
    for (const double age : behind)
      if (!(age >= 0.0 && age < kIssued)) file.blame("has a delay that is too long");
  }

  bp2::State now() const { return {shared.qpos, shared.qvel, leg}; }

  void reset() {
    person.reset();
    issued.fill({stand, {}});
    before = stand_torque;
    std::copy(before.begin(), before.end(), shared.torque);
    time = 0.0;
  }

  void apply(const bp2::Joints& torque) {
    std::copy(torque.begin(), torque.end(), shared.torque);
    motors.resist(now(), torque, shared.force);
  }
};
std::unique_ptr<Robot> robot;

}  // namespace

/// Memory for a file of this size.
EXPORTED(room) unsigned char* room(std::size_t size) { return static_cast<unsigned char*>(std::malloc(size)); }

EXPORTED(numbers) double* numbers() { return shared.qpos; }

/// Takes a controller's file and a robot's. Returns what is wrong with them, or "".
EXPORTED(load) const char* load(const unsigned char* file, std::size_t size, const unsigned char* other, std::size_t length) {
  controller = bp2::Controller::load(file, size, wrong);
  bp2::detail::File parts(other, length);
  robot.reset(new Robot(parts));
  if (wrong.empty() && !parts.wrong.empty()) wrong = "the robot's file " + parts.wrong;
  return wrong.c_str();
}

/// Lets the robot stand at the start, with zero commands.
EXPORTED(reset) void reset() {
  controller->reset();
  robot->reset();
}

/// Computes the joint targets of a control step. Returns why the watchdog stopped, or "".
EXPORTED(tick) const char* tick() {
  const bp2::State now = robot->now();
  const bp2::Measurement seen = now.measure(robot->up, robot->time);
  const bp2::Vector command = robot->person.ask(shared.wish, *controller, now, kTick);
  std::copy_backward(robot->issued.begin(), robot->issued.end() - 1, robot->issued.end());
  robot->issued[0] = controller->step(&seen, command.data(), robot->time);
  robot->time += kTick;
  std::copy(controller->command().begin(), controller->command().end(), shared.told);
  return controller->fault();
}

/// Computes torques and losses of a control step's next millisecond.
EXPORTED(drive) void drive(std::size_t millisecond) {
  std::copy_n(shared.torque, bp2::kJoints, robot->before.begin());
  const bp2::Targets& target = robot->issued[static_cast<std::size_t>(robot->behind[millisecond])];
  robot->apply(robot->motors.torque(robot->before, robot->now(), target));
}

/// Reduces the torques of a trial; returns whether it must be taken again with less.
EXPORTED(correct) bool correct() {
  bp2::Joints torque;
  std::copy_n(shared.torque, bp2::kJoints, torque.begin());
  const bp2::State after{shared.qpos, shared.after, robot->leg};
  if (robot->motors.correct(torque, robot->before, robot->now(), after, shared.mobility) <= kOutside) return false;
  robot->apply(torque);
  return true;
}
