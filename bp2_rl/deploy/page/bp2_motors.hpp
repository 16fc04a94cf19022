// What stands between a controller and MuJoCo's physics, for a page that simulates a robot:
// motors and losses within each millisecond, and the operator who turns a wish into
// commands.
//
// The laws are those of bp2_rl's `robot/actuator.py`, `robot/losses.py` and
// `play/session.py`; a test holds them together. All numbers come from a file of the
// controller's format.
#pragma once

#include "bp2_controller.hpp"

namespace bp2 {

/// A robot's state in MuJoCo's coordinates: trunk, then each leg's joints and, where
/// `leg` is 4, its spring.
struct State {
  const double *qpos, *qvel;
  std::size_t leg;  // numbers of a leg

  std::size_t place(std::size_t joint) const { return 6 + joint / 3 * leg + joint % 3; }
  double q(std::size_t joint) const { return qpos[place(joint) + 1]; }
  double qd(std::size_t joint) const { return qvel[place(joint)]; }

  /// The yaw of the trunk, rad.
  double yaw() const {
    const double *q = qpos + 3;
    return std::atan2(2.0 * (q[0] * q[3] + q[1] * q[2]), 1.0 - 2.0 * (q[2] * q[2] + q[3] * q[3]));
  }

  /// What encoders and IMU measure; `up` is the vertical in the world's frame.
  Measurement measure(const Vector& up, double time) const {
    Measurement seen{};
    for (std::size_t i = 0; i < kJoints; ++i) {
      seen.joint_position[i] = q(i);
      seen.joint_velocity[i] = qd(i);
    }
    const double w = qpos[3];
    const Vector v = {qpos[4], qpos[5], qpos[6]};
    const double along = v[0] * up[0] + v[1] * up[1] + v[2] * up[2], length = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    for (std::size_t i = 0, j = 1, k = 2; i < 3; ++i, j = (j + 1) % 3, k = (k + 1) % 3) {
      seen.up[i] = (w * w - length) * up[i] + 2.0 * along * v[i] - 2.0 * w * (v[j] * up[k] - v[k] * up[j]);
      seen.angular_velocity[i] = qvel[3 + i];
    }
    seen.time = time;
    return seen;
  }
};

/// The motors of a robot and the bus that they share, and what resists its motion.
class Motors {
 public:
  explicit Motors(detail::File& file) {
    const std::pair<const char*, Joints*> by_joint[] = {
        {"motors.stiffness", &stiffness_}, {"motors.damping", &damping_}, {"motors.peak_torque", &peak_},
        {"motors.corner_speed", &corner_}, {"motors.no_load_speed", &no_load_}, {"motors.braking_speed", &braking_},
        {"motors.current_lag", &lag_}, {"motors.torque_rate", &rate_}, {"losses.joint_friction", &friction_},
        {"losses.joint_viscosity", &viscosity_}};
    for (const auto& [name, values] : by_joint) *values = file.array<kJoints>(name);
    const std::pair<const char*, double*> numbers[] = {
        {"bus.power_out", &power_out_}, {"bus.power_in", &power_in_}, {"bus.sag", &sag_}, {"losses.drag", &drag_},
        {"losses.headwind", &headwind_}, {"losses.gear_loss", &gear_loss_}, {"losses.spring_friction", &slide_},
        {"losses.rebound_damping", &rebound_}, {"losses.joint_hold", &joint_hold_},
        {"losses.spring_hold", &spring_hold_}};
    for (const auto& [name, number] : numbers) *number = file.number(name);
  }

  /// The torques for the next millisecond, Nm, after the torques `before`: PD law, current
  /// loop, rate limit, envelope, bus.
  Joints torque(const Joints& before, const State& at, const Targets& target) const {
    Joints torque;
    const Limits limit = limits(at, voltage(before, at));
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double asked = stiffness_[i] * (target.position[i] - at.q(i)) + damping_[i] * (target.velocity[i] - at.qd(i));
      const double step = kStep / (lag_[i] + kStep) * (asked - before[i]), most = rate_[i] * kStep;
      torque[i] = detail::clip(before[i] + detail::clip(step, -most, most), limit.lower[i], limit.upper[i]);
    }
    return share_bus(torque, limit, at);
  }

  /// The forces that resist motion under the motors' torque, on the coordinates of `qvel`.
  void resist(const State& at, const Joints& torque, double* force) const {
    std::fill_n(force, 6 + kLegs * at.leg, 0.0);
    const double wind[] = {at.qvel[0] + headwind_, at.qvel[1]}, speed = std::sqrt(wind[0] * wind[0] + wind[1] * wind[1]);
    for (std::size_t i = 0; i < 2; ++i) force[i] = -drag_ * speed * wind[i];
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double most = friction_[i] + gear_loss_ * std::abs(torque[i]);
      force[at.place(i)] = -detail::clip(joint_hold_ * at.qd(i), -most, most) - viscosity_[i] * at.qd(i);
    }
    for (std::size_t leg = 0; at.leg == 4 && leg < kLegs; ++leg) {
      const std::size_t spring = 6 + 4 * leg + 3;
      const double rate = at.qvel[spring];
      force[spring] = -detail::clip(spring_hold_ * rate, -slide_, slide_) - (at.qpos[spring + 1] < 0.0 ? rebound_ * rate : 0.0);
    }
  }

  /// Reduces torques that lie outside the limits at a millisecond's end, where the speeds
  /// are those of `after`; `mobility` is each joint's acceleration per torque. Returns the
  /// largest excess, Nm.
  double correct(Joints& torque, const Joints& before, const State& at, const State& after, const double* mobility) const {
    const double u = voltage(before, at);
    const Limits now = limits(at, u), then = limits(after, u);
    double largest = 0.0;
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double outside = torque[i] - detail::clip(torque[i], then.lower[i], then.upper[i]);
      largest = detail::larger(largest, std::abs(outside));
      torque[i] -= outside / (1.0 + stall(i) / no_load_[i] * kStep * mobility[i]);
    }
    torque = share_bus(torque, now, at);
    return largest;
  }

 private:
  struct Limits { Joints lower, upper; };
  static constexpr double kStep = 1e-3, kLeastVoltage = 0.3;

  double stall(std::size_t i) const { return peak_[i] / (1.0 - corner_[i] / no_load_[i]); }
  double heat(std::size_t i) const { return no_load_[i] / stall(i); }  // W/Nm2

  double voltage(const Joints& torque, const State& at) const {
    double power = 0.0;
    for (std::size_t i = 0; i < kJoints; ++i) power += torque[i] * at.qd(i) + heat(i) * torque[i] * torque[i];
    return detail::clip(1.0 - sag_ * power, kLeastVoltage, 1.0);
  }

  Limits limits(const State& at, double voltage) const {
    Limits limit;
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double qd = at.qd(i), peak = peak_[i], brake = peak / (1.0 - corner_[i] / braking_[i]);
      const auto drive = [&](double speed) { return detail::clip(stall(i) * (voltage - speed / no_load_[i]), -peak, peak); };
      const auto hold = [&](double speed) { return detail::clip(brake * (1.0 - speed / braking_[i]), 0.0, peak); };
      const double lower = -drive(-qd), upper = drive(qd);
      // beyond the no-load speed the back EMF brakes, whatever the drive can
      limit.lower[i] = std::min(std::max(lower, -hold(qd)), upper);
      limit.upper[i] = std::max(std::min(upper, hold(-qd)), lower);
    }
    return limit;
  }

  /// The torques, reduced by one share so that their power is within the bus's limits.
  Joints share_bus(const Joints& torque, const Limits& limit, const State& at) const {
    Joints least, way;
    double p0 = 0.0, p1 = 0.0, p2 = 0.0;  // the power is p0 + p1 s + p2 s^2 at a share s
    for (std::size_t i = 0; i < kJoints; ++i) {
      least[i] = detail::clip(0.0, limit.lower[i], limit.upper[i]);
      way[i] = torque[i] - least[i];
      p0 += least[i] * at.qd(i) + heat(i) * least[i] * least[i];
      p1 += way[i] * at.qd(i) + 2.0 * heat(i) * least[i] * way[i];
      p2 += heat(i) * way[i] * way[i];
    }
    const auto share = [&](double power, double sign) {
      const double root = std::sqrt(std::max(p1 * p1 - 4.0 * p2 * (p0 - power), 0.0));
      return detail::clip((sign * root - p1) / (2.0 * (p2 > 0.0 ? p2 : 1.0)), 0.0, 1.0);
    };
    const double whole = p0 + p1 + p2;
    const double s = whole > power_out_ ? share(power_out_, 1.0) : whole < -power_in_ ? share(-power_in_, -1.0) : 1.0;
    Joints shared;
    for (std::size_t i = 0; i < kJoints; ++i) shared[i] = least[i] + s * way[i];
    return shared;
  }

  Joints stiffness_, damping_, peak_, corner_, no_load_, braking_, lag_, rate_, friction_, viscosity_;
  double power_out_, power_in_, sag_, drag_, headwind_, gear_loss_, slide_, rebound_, joint_hold_, spring_hold_;
};

/// A person's wish as a command: approached at limited rates, sideways no more than
/// friction holds, and back to the line on a straight run.
class Operator {
 public:
  explicit Operator(detail::File& file)
      : rise_(file.array<3>("wish.rise")), fall_(file.array<3>("wish.fall")),
        heading_gain_(file.number("operator.heading_gain")), lane_gain_(file.number("operator.lane_gain")),
        limit_(file.number("operator.limit")), lateral_(file.number("commands.max_lateral")),
        forward_(file.number("commands.max_forward")), turn_(file.number("commands.max_turn")),
        yaw_rate_(file.number("commands.max_yaw_rate")) {}

  void reset() { asked_ = line_ = {}; }

  /// The command for a wish (m/s forward, m/s to the left, rad/s) in a control step of
  /// `dt` seconds.
  Vector ask(const double* wish, const Controller& controller, const State& at, double dt) {
    asked_[0] = controller.command()[0];
    for (std::size_t i = 0; i < 3; ++i) asked_[i] += detail::clip(wish[i] - asked_[i], -fall_[i] * dt, rise_[i] * dt);
    asked_[0] = controller.tell(asked_.data())[0];
    const double speed = std::abs(asked_[0]), left = lateral_ * (1.0 - 0.5 * speed / forward_);
    const double turn = std::min(yaw_rate_, turn_ / std::max(speed, 1e-6)), yaw = at.yaw();
    asked_[1] = detail::clip(asked_[1], -left, left);
    asked_[2] = detail::clip(asked_[2], -turn, turn);
    const bool straight = asked_[1] == 0.0 && asked_[2] == 0.0;
    if (!straight) line_ = {at.qpos[0], at.qpos[1], yaw};
    const double across = std::cos(line_[2]) * (at.qpos[1] - line_[1]) - std::sin(line_[2]) * (at.qpos[0] - line_[0]);
    const double rate = -heading_gain_ * std::remainder(yaw - line_[2], 2.0 * kPi) - lane_gain_ * across;
    Vector command = asked_;
    if (straight) command[2] = detail::clip(rate, -limit_, limit_);
    return command;
  }

 private:
  Vector rise_, fall_, asked_{}, line_{};  // line: x, y, yaw
  double heading_gain_, lane_gain_, limit_, lateral_, forward_, turn_, yaw_rate_;
};

}  // namespace bp2
