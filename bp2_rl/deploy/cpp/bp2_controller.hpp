// The controller of a bundle in C++: from measurements and commands to joint targets.
//
//   std::string wrong;
//   auto controller = bp2::Controller::load("controller.bin", wrong);  // null: see `wrong`
//   bp2::Targets targets = controller->step(&measurement, command, now);  // every 5 ms
//
// It computes what `OnboardController` of the bundle's Python code computes, with a
// watchdog of the same limits and faults; a test holds the two together. All numbers come
// from the file, which docs/deploy.md describes. C++17 and the standard library alone.
// After `load` nothing allocates, throws or locks. Laws are in double, the network in float.
#pragma once

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "bp2_controller.hpp finds sensors that say NaN: compile it without -ffast-math"
#endif

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <string>
#include <utility>
#include <vector>

namespace bp2 {

constexpr std::size_t kJoints = 12, kLegs = 4;  // FR, FL, RR, RL, each abad, hip, knee
constexpr double kPi = 3.14159265358979323846, kInfinity = HUGE_VAL;
using Vector = std::array<double, 3>;
using Joints = std::array<double, kJoints>;

/// What encoders and IMU say. The time is when it arrived, s, by the clock of `now`.
struct Measurement {
  Joints joint_position, joint_velocity;  // rad, rad/s
  Vector up, angular_velocity;  // the world's vertical, and rad/s, in the body frame
  double time;
};
static_assert(sizeof(Measurement) == 31 * sizeof(double));

/// What the drives follow: torque = stiffness (position - q) + damping (velocity - qd).
struct Targets { Joints position, velocity; };  // rad, rad/s

/// Whose signs and zeros joint angles have: the bundle's, or the robot's own model's.
enum class Convention { bundle, model };

/// Reasons for which the watchdog stops the policy, as in the table of docs/deploy.md.
enum Fault {
  kNone, kNotFinite, kClock, kSilence, kRange, kJointSpeed, kTurning, kUp, kTilt, kFrozen, kJointVelocity, kGyro,
  kOffTarget, kOpposed, kStill, kRate, kNetwork, kTargets, kFaults
};
constexpr const char* kFaultNames[kFaults] = {
    "", "not finite", "clock", "silence", "range", "joint speed", "turning", "up", "tilt", "frozen", "joint velocity",
    "gyro", "off target", "opposed", "still", "rate", "network", "targets"};

namespace detail {

// Both keep NaN, unlike std::clamp and std::max.
template <class T> T clip(T x, T low, T high) { return x < low ? low : x > high ? high : x; }
inline double larger(double a, double b) { return a > b || std::isnan(a) ? a : b; }
inline double square(double x) { return x * x; }

// --- The file -------------------------------------------------------------------------

/// The CRC-32 of zlib and PNG.
inline std::uint32_t crc32(const unsigned char* data, std::size_t size) {
  std::uint32_t table[256], crc = ~std::uint32_t{0};
  for (std::uint32_t i = 0; i < 256; ++i) {
    table[i] = i;
    for (int bit = 0; bit < 8; ++bit) table[i] = table[i] >> 1 ^ (table[i] & 1 ? 0xEDB88320u : 0u);
  }
  for (std::size_t i = 0; i < size; ++i) crc = crc >> 8 ^ table[(crc ^ data[i]) & 255];
  return ~crc;
}

/// A controller's file: texts and arrays of numbers by name. What is asked for and is not
/// there, or is out of its bounds, is noted in `wrong`, and zeros are returned.
struct File {
  static constexpr std::uint32_t kVersion = 1;
  std::string wrong;

  explicit File(const std::string& path) {
    std::FILE* file = std::fopen(path.c_str(), "rb");
    unsigned char buffer[1 << 12];
    while (const std::size_t n = file ? std::fread(buffer, 1, sizeof buffer, file) : 0)
      bytes_.insert(bytes_.end(), buffer, buffer + n);
    if (file) std::fclose(file);
    file ? parse() : blame("cannot be read");
  }

  File(const unsigned char* bytes, std::size_t size) : bytes_(bytes, bytes + size) { parse(); }

  std::string text(const std::string& name) {
    const Record* record = find(name, 0);
    return record ? std::string(reinterpret_cast<const char*>(record->data), length(*record)) : "";
  }

  std::vector<std::string> texts(const std::string& name) {
    std::vector<std::string> lines(1);
    for (const char c : text(name))
      if (c == '\n') lines.emplace_back();
      else lines.back() += c;
    return lines;
  }

  /// The number of numbers in an array; 0 where there is none.
  std::size_t size(const std::string& name) const {
    for (const Record& record : records_)
      if (record.name == name) return length(record);
    return 0;
  }

  template <class T = double>
  std::vector<T> numbers(const std::string& name, std::size_t count) {
    const Record* record = find(name, sizeof(T));
    if (!record || record->count != count) {
      blame(name + " has not " + std::to_string(count) + " numbers");
      return std::vector<T>(std::min(count, 2 * kJoints));
    }
    std::vector<T> found(count);
    if (count > 0) std::memcpy(found.data(), record->data, count * sizeof(T));
    for (T& x : found)
      if (!(record->least <= x && x <= record->most)) {
        blame(name + " is " + std::to_string(x) + ", which is out of its bounds");
        x = 0;
      }
    return found;
  }

  double number(const std::string& name) { return numbers(name, 1)[0]; }
  float single(const std::string& name) { return static_cast<float>(number(name)); }

  template <std::size_t N> std::array<double, N> array(const std::string& name) {
    std::array<double, N> found;
    const std::vector<double> all = numbers(name, N);
    std::copy(all.begin(), all.end(), found.begin());
    return found;
  }

  /// Notes what is wrong, in ASCII, unless something was before.
  void blame(const std::string& what) {
    if (!wrong.empty()) return;
    for (const char c : what) wrong += c < ' ' || c > '~' ? '?' : c;
  }

  struct Head {
    std::uint32_t letters, kind;  // of the name; 0: text, else bytes of a number
    std::uint64_t count;
    double least, most;
  };
  struct Record : Head {
    std::string name;
    const unsigned char* data;
  };

  static std::size_t length(const Record& record) { return static_cast<std::size_t>(record.count); }

  template <class T> T at(std::size_t offset) const {
    T value;
    std::memcpy(&value, &bytes_[offset], sizeof value);
    return value;
  }

  void parse() {
    if (bytes_.size() < 24 || std::memcmp(bytes_.data(), "BP2C", 4) != 0) return blame("is no controller's file");
    // a machine that is not little-endian reads another version
    if (const auto found = at<std::uint32_t>(4); found != kVersion)
      return blame("has version " + std::to_string(found) + ", this code reads " + std::to_string(kVersion));
    const std::size_t end = bytes_.size() - 8;
    if (at<std::uint64_t>(end) != crc32(bytes_.data(), end)) return blame("is damaged");
    for (std::size_t offset = 16; offset < end;) {
      if (end - offset < sizeof(Head)) return blame("ends in the middle of a record");
      const Head head = at<Head>(offset);
      const std::uint64_t width = head.kind == 0 ? 1 : head.kind, room = end - offset - sizeof head;
      const bool fits = width <= 8 && head.letters <= room && head.count <= room / width;
      const std::uint64_t name = padded(head.letters), size = padded(head.count * width);
      if (!fits || name + size > room) return blame("has a record that is too long");
      const unsigned char* start = &bytes_[offset] + sizeof head;
      records_.push_back({head, std::string(reinterpret_cast<const char*>(start), head.letters), start + name});
      offset += sizeof head + name + size;
    }
  }

  static std::uint64_t padded(std::uint64_t size) { return (size + 7) / 8 * 8; }

  const Record* find(const std::string& name, std::size_t kind) {
    for (const Record& record : records_)
      if (record.name == name && record.kind == kind) return &record;
    blame("has no " + name);
    return nullptr;
  }

  std::vector<unsigned char> bytes_;
  std::vector<Record> records_;
};
// --- Numbers with their rates ---------------------------------------------------------

/// A value and its rate by time, which go together through every operation.
struct Dual {
  double v, d;
  Dual(double value = 0.0, double rate = 0.0) : v(value), d(rate) {}
};
inline Dual operator+(Dual a, Dual b) { return {a.v + b.v, a.d + b.d}; }
inline Dual operator-(Dual a, Dual b) { return {a.v - b.v, a.d - b.d}; }
inline Dual operator*(Dual a, Dual b) { return {a.v * b.v, a.d * b.v + a.v * b.d}; }
inline Dual operator/(Dual a, Dual b) { return {a.v / b.v, (a.d - a.v / b.v * b.d) / b.v}; }
inline Dual sqrt(Dual a) { return {std::sqrt(a.v), a.d / (2.0 * std::sqrt(a.v))}; }
inline Dual sin(Dual a) { return {std::sin(a.v), std::cos(a.v) * a.d}; }
inline Dual cos(Dual a) { return {std::cos(a.v), -std::sin(a.v) * a.d}; }
inline Dual exp(Dual a) { return {std::exp(a.v), std::exp(a.v) * a.d}; }
inline Dual atan2(Dual y, Dual x) { return {std::atan2(y.v, x.v), (y.d * x.v - y.v * x.d) / (x.v * x.v + y.v * y.v)}; }
using Point = std::array<Dual, 3>;

// --- Laws that all reference motions share --------------------------------------------

/// Numbers that are no robot's.
struct Constants {
  std::array<double, kLegs> trot, mirrored;  // cycles ahead; index of the mirror image
  std::array<double, 3> flexion;
  double gravity, shortest_squared, cosine_limit, least_left;

  explicit Constants(File& file)
      : trot(file.array<4>("constants.trot")), mirrored(file.array<4>("constants.mirrored")),
        flexion(file.array<3>("constants.flexion")), gravity(file.number("constants.gravity")),
        shortest_squared(file.number("constants.shortest_squared")),
        cosine_limit(1.0 - file.number("constants.cosine_margin")), least_left(file.number("constants.least_left")) {}
};

/// Where a point of the ground is, seen from above in the moving trunk's frame, `tau`
/// seconds after it was at (x, y).
inline std::array<Dual, 2> ground(double x, double y, const Vector& command, Dual tau) {
  const double vx = command[0], vy = command[1];
  const Dual half = command[2] / 2.0 * tau, h2 = half * half;
  const Dual chord = tau * (1.0 - h2 / 6.0 * (1.0 - h2 / 20.0 * (1.0 - h2 / 42.0)));
  const Dual c = cos(half), s = sin(half), c2 = cos(2.0 * half), s2 = sin(2.0 * half);
  return {c2 * x + s2 * y - chord * (c * vx + s * vy), c2 * y - s2 * x - chord * (c * vy - s * vx)};
}

/// The square of the speed that the outermost foot must have.
inline double square_speed(const Vector& command, double circle) {
  return square(command[0]) + square(command[1]) + square(circle * command[2]);
}

struct Leg { double lateral, drop, thigh, bend, lower; };

inline std::array<Leg, kLegs> read_legs(File& file, const std::string& of) {
  std::array<Leg, kLegs> legs;
  for (const auto& [name, to] : {std::pair("lateral", &Leg::lateral), {"drop", &Leg::drop}, {"thigh", &Leg::thigh},
                                 {"bend", &Leg::bend}, {"lower", &Leg::lower}}) {
    const auto values = file.array<kLegs>(of + name);
    for (std::size_t i = 0; i < kLegs; ++i) legs[i].*to = values[i];
  }
  return legs;
}

/// Joint angles for a foot's place relative to the leg's abduction axis.
inline Point joint_angles(const Point& foot, Dual lower, const Leg& leg, const Constants& is) {
  const auto& [x, y, z] = foot;
  const double d = leg.lateral, thigh = leg.thigh;
  const Dual square = y * y + z * z - d * d;
  Dual h = sqrt(square.v > is.shortest_squared ? square : Dual(is.shortest_squared));
  const Dual abad = atan2(d * z + h * y, d * y - h * z);
  h = h - leg.drop;
  Dual cosine = (x * x + h * h - thigh * thigh - lower * lower) / (2.0 * thigh * lower);
  if (std::abs(cosine.v) > is.cosine_limit) cosine = std::copysign(is.cosine_limit, cosine.v);
  const Dual sine = leg.bend * sqrt(1.0 - cosine * cosine);
  return {abad, atan2(0.0 - x, h) - atan2(lower * sine, thigh + lower * cosine), atan2(sine, cosine)};
}

// --- Reference motions ----------------------------------------------------------------

struct Pose {
  Joints position{}, velocity{}, torque{};
  void set(std::size_t leg, const Point& q) {
    for (std::size_t j = 0; j < 3; ++j) {
      position[3 * leg + j] = q[j].v;
      velocity[3 * leg + j] = q[j].d;
    }
  }
};

struct Motion {
  virtual ~Motion() = default;
  virtual double phase_rate(const Vector& command) const = 0;  // cycles per second
  virtual double stepping(const Vector& command) const = 0;  // share of full steps
  virtual Pose pose(const Vector& command, double phase) const = 0;
};

struct Stand : Motion {
  explicit Stand(File& file) : rate_(file.number("reference.phase_rate")) {
    pose_.position = file.array<12>("arrays.pose");
  }
  double phase_rate(const Vector&) const override { return rate_; }
  double stepping(const Vector&) const override { return 1.0; }
  Pose pose(const Vector&, double) const override { return pose_; }

  double rate_;
  Pose pose_;
};

/// The kinematic trot, by the equations of bp2_rl's `reference/trot_law.py`.
struct KinematicTrot : Motion {
  explicit KinematicTrot(File& file)
      : is_(file), legs_(read_legs(file, "arrays.")), clearance_(file.array<4>("arrays.sole_clearance")),
        origins_(file.array<12>("arrays.origins")), nominal_(file.array<8>("arrays.nominal")) {
    const std::pair<const char*, double*> numbers[] = {
        {"circle", &circle_}, {"height", &height_}, {"sweep", &sweep_}, {"slow_stance", &slow_stance_},
        {"swing_time", &swing_time_}, {"flexion", &flexion_}, {"follow_through", &follow_through_},
        {"landing", &landing_}, {"stepping_speed", &stepping_speed_}, {"sag", &sag_},
        {"spring_travel", &spring_travel_}};
    for (const auto& [name, number] : numbers) *number = file.number(std::string("reference.") + name);
  }

  double phase_rate(const Vector& command) const override { return 1.0 / (stance_time(command) + swing_time_); }

  double stepping(const Vector& command) const override {
    const double s2 = square_speed(command, circle_);
    return s2 / (s2 + square(stepping_speed_));
  }

  Pose pose(const Vector& command, double phase) const override {
    const double stance = stance_time(command), period = stance + swing_time_;
    Pose pose;
    for (std::size_t leg = 0; leg < kLegs; ++leg) {
      const double cycle = phase - std::floor(phase) + is_.trot[leg];
      const double since = (cycle - std::floor(cycle)) * period;
      const bool stands = since < stance;
      const Point now = stands ? in_stance(leg, command, {since - stance / 2.0, 1.0})
                               : in_swing(leg, command, (since - stance) / swing_time_);
      pose.set(leg, now);
    }
    return pose;
  }

  double stance_time(const Vector& command) const {
    return slow_stance_ / std::sqrt(1.0 + square_speed(command, circle_) * square(slow_stance_ / sweep_));
  }

  Point in_stance(std::size_t leg, const Vector& command, Dual tau) const {
    const double stance = stance_time(command), rate = phase_rate(command), steps = stepping(command);
    const double most = 1.2 * spring_travel_;  // beyond, the stop takes the force
    double mean = steps * sag_ / (stance * rate);
    mean *= std::pow(1.0 + std::pow(1.5 * mean / most, 8), -0.125);
    const Dual share = 2.0 / stance * tau, w = 1.0 - share * share;
    const Dual pulse = w * (landing_ + (1.0 - landing_) * w) / (2.0 / 3.0 - 2.0 / 15.0 * (1.0 - landing_));
    const Dual spring = (1.0 - steps) * sag_ + mean * pulse;
    const double harmonic = 2.0 - 4.0 / 3.0 * square(2.0 * stance * rate);
    const double amplitude = steps * harmonic * is_.gravity * square(1.0 / (4.0 * kPi * rate));
    const Dual height = height_ - amplitude * cos(4.0 * kPi * rate * tau);
    const auto [x, y] = ground(nominal_[2 * leg], nominal_[2 * leg + 1], command, tau);
    const double* origin = &origins_[3 * leg];
    Point foot = {x - origin[0], y - origin[1], clearance_[leg] - height - origin[2]};
    // A foot on the abduction axis is moved below it, by more than it can be above.
    if ((foot[1] * foot[1] + foot[2] * foot[2]).v < is_.shortest_squared)
      foot[2] = foot[2] - 2.0 * std::sqrt(is_.shortest_squared);
    return joint_angles(foot, legs_[leg].lower - spring, legs_[leg], is_);
  }

  Point in_swing(std::size_t leg, const Vector& command, double s) const {
    const double half = stance_time(command) / 2.0, n = follow_through_, time = swing_time_, r = 1.0 - s;
    const Point start = in_stance(leg, command, {half, 1.0}), end = in_stance(leg, command, {-half, 1.0});
    const double bend = legs_[leg].bend, followed = time / (n + 1.0) * (start[2].d - end[2].d) / 2.0;
    const double flexion = stepping(command) * flexion_ - bend * followed;
    Point now;
    for (std::size_t j = 0; j < 3; ++j) {
      const double out = start[j].d, back = end[j].d, flexed = flexion * bend * is_.flexion[j];
      const double mean = (end[j].v - start[j].v) / time - (out + back) / (n + 1.0);
      now[j].v = start[j].v + time / (n + 1.0) * (out * (1.0 - std::pow(r, n + 1.0)) + back * std::pow(s, n + 1.0)) +
                 time * mean * s * s * s * (10.0 - 15.0 * s + 6.0 * s * s) + flexed * 16.0 * square(s * r);
      now[j].d = out * std::pow(r, n) + back * std::pow(s, n) + mean * 30.0 * square(s * r) +
                 flexed / time * 32.0 * s * r * (r - s);
    }
    return now;
  }

  Constants is_;
  std::array<Leg, kLegs> legs_;
  std::array<double, kLegs> clearance_;
  std::array<double, 12> origins_;
  std::array<double, 8> nominal_;
  double circle_ = 0.0, height_ = 0.0, sweep_ = 0.0, slow_stance_ = 0.0, swing_time_ = 0.0, flexion_ = 0.0,
         follow_through_ = 0.0, landing_ = 0.0, stepping_speed_ = 0.0, sag_ = 0.0, spring_travel_ = 0.0;
};

/// The library of trots at any command, as `onboard/motion.py` plays it.
struct LibraryTrot : Motion {
  explicit LibraryTrot(File& file)
      : is_(file), speeds_(file.size("arrays.strides") / 5),
        intervals_(speeds_ > 0 ? file.size("arrays.cubics") / (2 * 4 * kRow * speeds_) : 0),
        strides_(file.numbers("arrays.strides", 5 * speeds_)),
        cubics_(file.numbers("arrays.cubics", 2 * intervals_ * speeds_ * 4 * kRow)),
        rest_(file.array<12>("arrays.stand_feet")), hips_(file.array<12>("arrays.leg_origins")),
        rest_torque_(file.array<8>("arrays.stand_torque")),
        stepping_speed_(file.number("reference.stepping_speed")), circle_(file.number("reference.foot_circle")),
        legs_(read_legs(file, "reference.legs.")), sag_(file.array<4>("reference.legs.sag")),
        straight_(file.array<4>("reference.legs.straight_knee")) {
    if (speeds_ < 2 || intervals_ < 1) file.blame("has a library without two speeds");
    for (const double image : is_.mirrored)
      if (!(image >= 0.0 && image < kLegs)) file.blame("has legs whose mirror images are none");
  }

  double phase_rate(const Vector& command) const override { return 0.5 / stride(command).half; }

  double stepping(const Vector& command) const override {
    const double y = std::min(square_speed(command, circle_) / square(stepping_speed_), 1.0);
    return y * (2.0 - y);
  }

  Pose pose(const Vector& command, double phase) const override {
    const Stride at = stride(command);
    const double steps = stepping(command), cycle = phase - std::floor(phase);
    const bool mirrored = cycle >= 0.5;
    // s, since the last pair of feet landed
    const Dual now((2.0 * cycle - mirrored) * at.half, 1.0);
    const Row row = sample(at, now);
    Pose pose;
    for (std::size_t leg = 0; leg < kLegs; ++leg) {
      const std::size_t source = mirrored ? static_cast<std::size_t>(is_.mirrored[leg]) : leg;
      const auto moved = [&](double rest, std::size_t i) { return rest + steps * (row[3 + 3 * source + i] - rest); };
      const Dual x = moved(rest_[3 * leg], 0), z = moved(rest_[3 * leg + 2], 1), spring = moved(sag_[leg], 2);
      const bool later = (is_.trot[leg] > 0.0) != mirrored;
      const auto [dx, dy] = displacement(leg, command, at, steps, later ? now + at.half : now);
      const double y = rest_[3 * leg + 1];
      const Point q = joints(leg, {x, y, z}, {x + dx, y + dy, z}, legs_[leg].lower - spring, steps * row[2]);
      pose.set(leg, q);
      for (std::size_t j = 0; j < 2; ++j) {
        const double rest = rest_torque_[2 * leg + j];
        pose.torque[3 * leg + 1 + j] = rest + steps * (row[15 + 2 * source + j].v - rest);
      }
    }
    return pose;
  }

  static constexpr std::size_t kRow = 23;  // trunk 3, then 3 a leg, then 2 torques a leg
  using Row = std::array<Dual, kRow>;

  struct Stride { std::size_t row; double a, b, speed, stance, half, fore, hind; };

  Stride stride(const Vector& command) const {
    const auto of = [&](std::size_t row, std::size_t i) { return strides_[5 * row + i]; };
    const double speed = std::min(std::max(command[0], of(0, 0)), of(speeds_ - 1, 0));
    std::size_t row = 0;
    while (row < speeds_ - 2 && of(row + 1, 0) <= speed) ++row;
    const double above = (of(row + 1, 0) - speed) * (of(row + 1, 1) + of(row + 1, 2));
    const double below = (speed - of(row, 0)) * (of(row, 1) + of(row, 2));
    const double a = above / (above + below), b = below / (above + below);
    const auto mean = [&](std::size_t i) { return a * of(row, i) + b * of(row + 1, i); };
    return {row, a, b, speed, mean(1), mean(1) + mean(2), mean(3), mean(4)};
  }

  Row sample(const Stride& at, Dual since) const {
    const bool flies = since.v >= at.stance;
    const double duration = flies ? at.half - at.stance : at.stance, n = static_cast<double>(intervals_);
    const Dual place = (flies ? since - at.stance : since) / duration * n;
    const double interval = place.v >= 1.0 ? std::min(std::floor(place.v), n - 1.0) : 0.0;
    const Dual u = place - interval;
    const std::size_t index = (flies ? intervals_ : 0) + static_cast<std::size_t>(interval);
    const double *low = &cubics_[(index * speeds_ + at.row) * 4 * kRow], *high = low + 4 * kRow;
    Row row;
    for (std::size_t i = 0; i < kRow; ++i) {
      const auto c = [&](std::size_t power) { return at.a * low[power * kRow + i] + at.b * high[power * kRow + i]; };
      row[i] = c(0) + u * (c(1) + u * (c(2) + u * c(3)));
    }
    return row;
  }

  std::array<Dual, 2> displacement(std::size_t leg, const Vector& command, const Stride& at, double steps,
                                   Dual since) const {
    const double middle = leg < 2 ? at.fore : at.hind, y0 = rest_[3 * leg + 1];
    const double x0 = rest_[3 * leg] + steps * (middle - rest_[3 * leg]), library = steps * at.speed;
    const Vector v = {std::min(command[0], strides_[5 * (speeds_ - 1)]), command[1], command[2]};
    const auto drift = [&](Dual tau) -> std::array<Dual, 2> {
      const auto [x, y] = ground(x0, y0, v, tau);
      return {x - x0 + library * tau, y - y0};
    };
    const double half = at.stance / 2.0, time = 2.0 * (at.half - half);
    if (since.v < at.stance) return drift(since - half);
    const auto out = drift({half, 1.0}), in = drift({-half, 1.0});
    const Dual s = (since - at.stance) / time, r = 1.0 - s;
    const auto cubic = [&](Dual a, Dual b) {
      return a.v * r * r * (1.0 + 2.0 * s) + b.v * s * s * (3.0 - 2.0 * s) + time * s * r * (a.d * r - b.d * s);
    };
    return {cubic(out[0], in[0]), cubic(out[1], in[1])};
  }

  /// Joint angles that put a foot at its displaced place, kept within reach: a
  /// displacement beyond half of the reach that is left gets the rest only by and by.
  Point joints(std::size_t leg, const Point& before, const Point& after, Dual lower, Dual pitch) const {
    const Dual c = cos(pitch), s = sin(pitch);
    const double *hip = &hips_[3 * leg], drop = legs_[leg].drop, thigh = legs_[leg].thigh;
    const auto from_hip = [&](const Point& p) -> Point {
      return {c * p[0] - s * p[2] - hip[0], p[1] - hip[1], c * p[2] + s * p[0] - hip[2] + drop};
    };
    const auto length = [](const Point& p) { return sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]); };
    Point foot = from_hip(after);
    const Dual now = length(from_hip(before)), then = length(foot);
    const double extended = 2.0 * thigh * std::cos(straight_[leg]), d = legs_[leg].lateral;
    const Dual straight = sqrt(thigh * thigh + lower * lower + extended * lower + d * d);
    Dual left = (straight - now) / 2.0;
    if (left.v < is_.least_left) left = is_.least_left;
    const Dual beyond = then - now - left;
    if (beyond.v > 0.0) {
      const Dual share = (now + left + left * (1.0 - exp((0.0 - beyond) / left))) / then;
      for (Dual& x : foot) x = share * x;
    }
    foot[2] = foot[2] - drop;
    return joint_angles(foot, lower, legs_[leg], is_);
  }

  Constants is_;
  std::size_t speeds_, intervals_;
  std::vector<double> strides_, cubics_;
  std::array<double, 12> rest_, hips_;
  std::array<double, 8> rest_torque_;
  double stepping_speed_, circle_;
  std::array<Leg, kLegs> legs_;
  std::array<double, kLegs> sag_, straight_;
};

// --- The network ----------------------------------------------------------------------

struct Network {
  explicit Network(File& file) {
    const std::string activation = file.text("network.activation");
    const char* known[] = {"swish", "elu", "tanh", "relu"};
    activation_ = static_cast<int>(std::find(known, known + 4, activation) - known);
    if (activation_ == 4) file.blame("has a network of another kind: " + activation);
    inputs_ = file.size("network.mean");
    mean_ = file.numbers<float>("network.mean", inputs_);
    std_ = file.numbers<float>("network.std", inputs_);
    std::size_t widest = inputs_, width = inputs_;
    for (std::size_t i = 0; file.size("network.bias_" + std::to_string(i)) > 0; ++i) {
      const std::string bias = "network.bias_" + std::to_string(i), weight = "network.weight_" + std::to_string(i);
      const std::size_t n = file.size(bias);
      layers_.push_back({width, n, file.numbers<float>(weight, width * n), file.numbers<float>(bias, n)});
      width = n;
      widest = std::max(widest, width);
    }
    if (layers_.empty() || width != kJoints) file.blame("has a network without 12 actions");
    here_.resize(widest);
    there_.resize(widest);
  }

  /// The 12 actions for an observation.
  const float* operator()(const float* seen) {
    for (std::size_t i = 0; i < inputs_; ++i) here_[i] = (seen[i] - mean_[i]) / std_[i];
    for (const Layer& layer : layers_) {
      multiply(layer, here_.data(), there_.data());
      if (&layer != &layers_.back())
        for (std::size_t i = 0; i < layer.outputs; ++i) there_[i] = activate(there_[i]);
      here_.swap(there_);
    }
    return here_.data();
  }

  struct Layer {
    std::size_t inputs, outputs;
    std::vector<float> weight, bias;  // weight: inputs x outputs
  };

  float activate(float x) const {
    if (activation_ == 0) return x / (1.0f + std::exp(-x));
    if (activation_ == 1) return x > 0.0f ? x : std::expm1(x);
    if (activation_ == 2) return std::tanh(x);
    return x < 0.0f ? 0.0f : x;
  }

  static void multiply(const Layer& layer, const float* x, float* __restrict y) {
    const std::size_t n = layer.outputs;
    std::copy(layer.bias.begin(), layer.bias.end(), y);
    const float* __restrict w = layer.weight.data();
    std::size_t i = 0;
    for (; i + 4 <= layer.inputs; i += 4, w += 4 * n) {
      const float a = x[i], b = x[i + 1], c = x[i + 2], d = x[i + 3];
      for (std::size_t j = 0; j < n; ++j) y[j] += a * w[j] + b * w[j + n] + c * w[j + 2 * n] + d * w[j + 3 * n];
    }
    for (; i < layer.inputs; ++i, w += n)
      for (std::size_t j = 0; j < n; ++j) y[j] += x[i] * w[j];
  }

  int activation_;
  std::size_t inputs_;
  std::vector<float> mean_, std_, here_, there_;
  std::vector<Layer> layers_;
};

// --- The watchdog ---------------------------------------------------------------------

/// Checks measurements and targets as `onboard/watchdog.py` does, whose docstrings explain
/// the checks. A function that returns bool returns false at a fault.
struct Watchdog {
  std::array<double, kFaults> used{};  // largest share of each limit so far
  Fault fault = kNone;
  std::size_t joint = kJoints;  // that the fault is of; kJoints if of none
  double braking, stand_time, joint_speed;

  explicit Watchdog(File& file) : dt_(1.0 / file.number("rates.policy")), huge_(file.number("constants.huge")) {
    const std::pair<const char*, double*> limits[] = {
        {"silence", &silence_}, {"ahead", &ahead_}, {"rate", &rate_limit_}, {"stand_time", &stand_time},
        {"braking", &braking}, {"joint_margin", &margin_}, {"joint_speed", &joint_speed}, {"target_step", &target_step_},
        {"turning", &turning_}, {"up_length", &up_length_}, {"tilt", &tilt_}, {"frozen", &frozen_},
        {"frozen_target", &frozen_target_}, {"window", &window_}, {"mismatch", &mismatch_}, {"joint_noise", &joint_noise_},
        {"turned", &turned_limit_}, {"unlike", &unlike_}, {"off_target", &off_target_}, {"opposed", &opposed_},
        {"swing", &swing_}, {"still", &still_}};
    for (const auto& [name, limit] : limits) *limit = file.number(std::string("watchdog.") + name);
    const auto range = file.array<2 * kJoints>("joint_range");
    for (std::size_t i = 0; i < kJoints; ++i) {
      middle_[i] = (range[2 * i] + range[2 * i + 1]) / 2.0;
      half_[i] = (range[2 * i + 1] - range[2 * i]) / 2.0;
    }
    reset();
  }

  void reset() {
    stop(kNone);
    now_ = -kInfinity;
    counted_from_ = heard_ = kInfinity;
    any_ = false;
    unheard_ = ticks_ = 0.0;
    turned_ = {};
  }

  /// The newest measurement: joint angles and speeds, up and gyro; null before the first.
  const double* newest() const { return any_ ? values_.data() : nullptr; }

  /// Checks a measurement, whose joint angles are `sign` x its own + `offset`.
  bool look(const Measurement* given, double now, const Joints& target, const Joints& sign, const Joints& offset) {
    const double latest = any_ ? now_ + window_ : kInfinity;
    if (!(now_ <= now && now <= latest) || std::isinf(now)) return stop(kClock);
    now_ = now;
    ticks_ = any_ ? ticks_ + 1 : 0;
    unheard_ = any_ ? unheard_ + 1 : 0;
    if (given) {
      Values values;
      if (!read(*given, values, sign, offset) || !within_limits(values)) return false;
      if ((!any_ || given->time > stamp_) && !accept(values, given->time, target)) return false;
    }
    if (!judge(kSilence, larger(now - heard_, unheard_ * dt_ / rate_limit_) / silence_)) return false;
    const double counted = larger(ticks_ * dt_ / rate_limit_, now_ - counted_from_ - window_);
    return counted <= window_ + silence_ || called_in_time();
  }

  bool check_targets(const Joints& position, const Joints& velocity, const Joints& before) {
    Joints shares;
    for (std::size_t i = 0; i < kJoints; ++i)
      shares[i] = larger(std::abs(position[i] - before[i]) / target_step_, std::abs(velocity[i]) / joint_speed);
    return judge(kTargets, shares);
  }

  bool stop(Fault reason, std::size_t of_joint = kJoints) {
    fault = reason;
    joint = of_joint;
    return false;
  }

  using Values = std::array<double, 30>;  // q 12, qd 12, up 3, gyro 3
  static constexpr std::size_t kUpPlace = 24, kGyroPlace = 27, kMoving = 15;  // joints and up

  bool read(const Measurement& given, Values& values, const Joints& sign, const Joints& offset) {
    std::memcpy(&values, &given, sizeof values);
    bool finite = std::isfinite(given.time);
    for (double& x : values) {
      finite = finite && std::isfinite(x);
      x = clip(x, -huge_, huge_);
    }
    for (std::size_t i = 0; i < kJoints; ++i) {
      values[i] = sign[i] * values[i] + offset[i];
      values[kJoints + i] *= sign[i];
    }
    return finite || stop(kNotFinite);
  }

  bool within_limits(const Values& values) {
    Joints beyond, speeds;
    for (std::size_t i = 0; i < kJoints; ++i) {
      beyond[i] = (std::abs(values[i] - middle_[i]) - half_[i]) / margin_;
      speeds[i] = std::abs(values[kJoints + i]) / joint_speed;
    }
    const double *up = &values[kUpPlace], *gyro = &values[kGyroPlace];
    const double fastest = std::max({std::abs(gyro[0]), std::abs(gyro[1]), std::abs(gyro[2])});
    const double length = std::hypot(up[0], up[1], up[2]);
    return judge(kRange, beyond) && judge(kJointSpeed, speeds) && judge(kTurning, fastest / turning_) &&
           judge(kUp, std::abs(length - 1.0) / up_length_) &&
           judge(kTilt, std::acos(clip(up[2] / length, -1.0, 1.0)) / tilt_);
  }

  bool accept(const Values& values, double stamp, const Joints& target) {
    const double age = now_ - stamp, passed = stamp - stamp_;
    if (age < -ahead_ || age > silence_) return stop(kClock);
    const double *up = &values[kUpPlace], *gyro = &values[kGyroPlace];
    std::array<double, kMoving> rate;
    std::copy_n(&values[kJoints], kJoints, rate.begin());
    for (std::size_t i = 0, j = 1, k = 2; i < 3; ++i, j = (j + 1) % 3, k = (k + 1) % 3)
      rate[kJoints + i] = up[j] * gyro[k] - up[k] * gyro[j];
    const bool first = !any_;
    const Vector last_up = {values_[kUpPlace], values_[kUpPlace + 1], values_[kUpPlace + 2]};
    any_ = true;
    heard_ = now_;
    unheard_ = 0;
    stamp_ = stamp;
    for (std::size_t i = 0; i < values.size(); ++i)
      if (first || values[i] != values_[i]) {
        since_[i] = stamp;
        if (i < kJoints) held_[i] = target[i];
      }
    values_ = values;
    if (first) count_calls();
    if (first || passed > silence_) return begin(rate, stamp);
    if (!changing(stamp, target)) return false;
    for (std::size_t i = 0; i < kMoving; ++i) {
      travel_[i] += 0.5 * (rate[i] + rate_[i]) * passed;
      const double change = values[i < kJoints ? i : kUpPlace + i - kJoints];
      note(i, change);
      note(kMoving + i, travel_[i]);
      note(2 * kMoving + i, change - travel_[i]);
    }
    for (std::size_t i = 0; i < kJoints; ++i) {
      note(kTargetPlace + i, target[i]);
      note(kOffPlace + i, values[i] - target[i]);
    }
    for (std::size_t i = 0; i < 3; ++i) note(kJumpPlace + i, up[i] - last_up[i]);
    rate_ = rate;
    ++count_;
    if (stamp - began_ < window_) return true;
    if (!compare_changes()) return false;
    count_calls();
    return begin(rate, stamp);
  }

  // Places in a row of sums: changes, travel and gap of joints and up, then these.
  static constexpr std::size_t kTargetPlace = 45, kOffPlace = 57, kJumpPlace = 69, kRow = 72;

  bool begin(const std::array<double, kMoving>& rate, double stamp) {
    rate_ = rate;
    travel_ = {};
    sum_ = squares_ = {};
    count_ = 0.0;
    began_ = stamp;
    return true;
  }

  void note(std::size_t place, double value) { sum_[place] += value; squares_[place] += value * value; }

  void count_calls() { counted_from_ = now_; ticks_ = 0.0; }

  bool changing(double stamp, const Joints& target) {
    for (const std::size_t place : {kUpPlace, kGyroPlace}) {
      const double latest = std::max({since_[place], since_[place + 1], since_[place + 2]});
      if (!judge(kFrozen, (stamp - latest) / frozen_)) return false;
    }
    Joints shares;
    for (std::size_t i = 0; i < kJoints; ++i)
      shares[i] = std::min((stamp - since_[i]) / frozen_, std::abs(target[i] - held_[i]) / frozen_target_);
    return judge(kFrozen, shares);
  }

  bool called_in_time() {
    const double calls = ticks_ / std::max(now_ - counted_from_, 1e-9) * dt_;
    return (1.0 / rate_limit_ <= calls && calls <= rate_limit_) || stop(kRate);
  }

  bool compare_changes() {
    if (!called_in_time()) return false;
    std::array<double, kRow> mean, variance;
    for (std::size_t i = 0; i < kRow; ++i) {
      mean[i] = sum_[i] / count_;
      variance[i] = larger(squares_[i] / count_ - mean[i] * mean[i], 0.0);
    }
    const auto power = [&](std::size_t i) { return variance[i] + variance[i + 1] + variance[i + 2]; };
    const double up = power(12), gyro = power(27), gap = power(42), jump = power(kJumpPlace);
    const Vector powers = {up - jump / 2.0, gyro, (up + gyro - gap) / 2.0};
    for (std::size_t i = 0; i < 3; ++i) turned_[i] = 0.5 * (turned_[i] + powers[i]);
    const double least = square(turned_limit_), most = std::max({turned_[0], turned_[1], least});
    if (!judge(kGyro, (1.0 - (most > least ? turned_[2] / most : 1.0)) / unlike_)) return false;
    Joints speeds, aside, opposed, still;
    const double swing = square(swing_);
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double travel = std::sqrt(variance[kMoving + i]), apart = std::sqrt(variance[2 * kMoving + i]);
      speeds[i] = apart / std::hypot(joint_noise_, mismatch_ * larger(std::sqrt(variance[i]), travel));
      const double own = variance[i], target = variance[kTargetPlace + i], off = variance[kOffPlace + i];
      aside[i] = std::abs(mean[kOffPlace + i]) / off_target_;
      const double against = std::min(own, target) > swing ? (off - own - target) / 2.0 : 0.0;
      opposed[i] = against / std::sqrt(larger(own * target, 1e-12)) / opposed_;
      const double moving = target > 2.25 * swing ? target : 0.0;
      still[i] = still_ * std::sqrt(moving / larger(own, 1e-12));
    }
    return judge(kJointVelocity, speeds) && judge(kOffTarget, aside) && judge(kOpposed, opposed) && judge(kStill, still);
  }

  bool judge(Fault limit, double of_limit, std::size_t of_joint = kJoints) {
    if (!(of_limit <= 1.0)) return stop(limit, of_joint);  // NaN, too
    used[limit] = std::max(used[limit], of_limit);
    return true;
  }

  bool judge(Fault limit, const Joints& shares) {
    std::size_t worst = 0;
    for (std::size_t i = 1; i < kJoints && !std::isnan(shares[worst]); ++i)
      if (!(shares[i] <= shares[worst])) worst = i;
    return judge(limit, shares[worst], worst);
  }

  Joints middle_{}, half_{}, held_{};
  double dt_, huge_, now_ = 0.0, counted_from_ = 0.0, heard_ = 0.0, stamp_ = 0.0, began_ = 0.0;
  double silence_, ahead_, rate_limit_, margin_, target_step_, turning_, up_length_, tilt_, frozen_, frozen_target_,
      window_, mismatch_, joint_noise_, turned_limit_, unlike_, off_target_, opposed_, swing_, still_;
  bool any_ = false;
  double unheard_ = 0.0, ticks_ = 0.0, count_ = 0.0;
  Values values_{}, since_{};
  std::array<double, kMoving> rate_{}, travel_{};
  std::array<double, kRow> sum_{}, squares_{};
  Vector turned_{};
};

}  // namespace detail

/// A robot's controller; not thread-safe.
class Controller {
 public:
  /// Reads a controller's file. Returns null, and says what is wrong, if it is damaged or
  /// not for this code.
  static std::unique_ptr<Controller> load(const std::string& path, std::string& wrong,
                                          Convention convention = Convention::bundle) {
    detail::File file(path);
    return load(file, path, wrong, convention);
  }

  /// Reads the content of a controller's file.
  static std::unique_ptr<Controller> load(const unsigned char* bytes, std::size_t size, std::string& wrong) {
    detail::File file(bytes, size);
    return load(file, "controller.bin", wrong, Convention::bundle);
  }

  /// The joint targets for the next 5 ms, from the newest measurement (null: none) and
  /// command (m/s forward, m/s to the left, rad/s; null: the operator is silent).
  Targets step(const Measurement* measurement, const double* command, double now) noexcept {
    if (!watchdog_.fault) {
      if (watchdog_.look(measurement, now, targets_.position, sign_, offset_)) {
        command_ = tell(command);
        if (watchdog_.newest()) act(watchdog_.newest());
      }
      if (watchdog_.fault) stopped_at_ = targets_.position;
    }
    if (watchdog_.fault) targets_ = to_stand();
    Targets told;
    for (std::size_t i = 0; i < kJoints; ++i) {
      told.position[i] = sign_[i] * (targets_.position[i] - offset_[i]);
      told.velocity[i] = sign_[i] * targets_.velocity[i];
    }
    return told;
  }

  /// What the policy would be told next for a command, within the limits.
  std::array<float, 3> tell(const double* command) const noexcept {
    std::array<float, 3> asked;
    if (command && std::all_of(command, command + 3, [](double x) { return std::isfinite(x); })) {
      for (std::size_t i = 0; i < 3; ++i) asked[i] = static_cast<float>(detail::clip(command[i], least_[i], most_[i]));
    } else {
      const double speed = std::sqrt(command_[0] * command_[0] + command_[1] * command_[1]);
      const double slower = std::max(speed - watchdog_.braking * dt_, 0.0);
      const float factor = static_cast<float>(speed > 0.0 ? slower / speed : 0.0);
      for (std::size_t i = 0; i < 3; ++i) asked[i] = command_[i] * factor;
    }
    const float before = command_[0], step = static_cast<float>(dt_);
    if (std::isfinite(launching_)) {
      const float rate = launching_ * detail::clip(1.0f - before / launching_speed_, 0.0f, 1.0f);
      asked[0] = std::min(asked[0], std::max(before, 0.0f) + step * rate);
    }
    if (std::isfinite(braking_) || stopping_time_ > 0.0f) {
      float rate = braking_;
      if (stopping_time_ > 0.0f) rate = std::min(rate, (before + ease_) / stopping_time_);
      if (before > 0.0f) asked[0] = std::max(asked[0], std::max(before - step * rate, 0.0f));
    }
    return asked;
  }

  /// Starts anew at a gait phase, the only way to go on after a fault.
  void reset(double phase = 0.0) noexcept {
    phase_ = phase;
    last_action_ = {};
    frames_ = 0;
    command_ = {};
    targets_ = {stand_, {}};
    ticks_stopped_ = 0.0;
    watchdog_.reset();
  }

  /// The watchdog's reason to stop, empty while the policy runs, and its joint, if it has one.
  const char* fault() const { return kFaultNames[watchdog_.fault]; }
  const char* fault_joint() const { return watchdog_.joint < kJoints ? names_[watchdog_.joint].c_str() : ""; }

  /// The largest share of each limit that was reached so far, by `Fault`.
  const std::array<double, kFaults>& used() const { return watchdog_.used; }
  const std::vector<std::string>& joint_names() const { return names_; }
  /// The command that the policy was told last, m/s, m/s and rad/s.
  const std::array<float, 3>& command() const { return command_; }
  double stiffness() const { return stiffness_; }  // of the drives, Nm/rad
  double damping() const { return damping_; }  // of the drives, Nm s/rad

 private:
  struct Change { std::size_t ticks, place, size; };
  using Moment = std::array<float, 47>;

  static std::unique_ptr<Controller> load(detail::File& file, const std::string& path, std::string& wrong,
                                          Convention convention) {
    std::unique_ptr<Controller> controller;
    if (file.wrong.empty()) controller.reset(new Controller(file, convention));
    if (file.wrong.empty()) controller->try_all(file);
    wrong = file.wrong.empty() ? "" : path + ": " + file.wrong + "; export the bundle anew";
    if (!wrong.empty()) controller.reset();
    return controller;
  }

  Controller(detail::File& file, Convention convention)
      : names_(file.texts(convention == Convention::model ? "model_joints.name" : "joints")),
        sign_(file.array<12>("model_joints.sign")), offset_(file.array<12>("model_joints.offset")),
        stand_(file.array<12>("control.stand")), range_(file.array<24>("joint_range")),
        least_(file.array<3>("command.least")), most_(file.array<3>("command.most")),
        dt_(1.0 / file.number("rates.policy")), scale_(file.number("control.action_scale")),
        stiffness_(file.number("gains.stiffness")), damping_(file.number("gains.damping")),
        feedforward_(file.number("control.feedforward") / stiffness_), limit_(file.single("control.action_limit")),
        launching_(file.single("control.launching")), launching_speed_(file.single("control.launching_speed")),
        braking_(file.single("control.braking")), stopping_time_(file.single("control.stopping_time")),
        ease_(file.single("constants.ease")), residual_(file.text("control.mode") == "residual"),
        clock_at_rest_(file.number("control.clock_at_rest") != 0.0), network_(file), watchdog_(file) {
    for (std::size_t i = 0; i < kJoints; ++i)
      if (std::abs(sign_[i]) != 1.0 || !(range_[2 * i] <= stand_[i] && stand_[i] <= range_[2 * i + 1]))
        file.blame("has a stand beyond the joints' range, or a sign that is neither 1 nor -1");
    if (convention == Convention::bundle) {
      sign_.fill(1.0);
      offset_.fill(0.0);
    }
    const std::string kind = file.text("reference.kind");
    if (kind == "collocation") motion_.reset(new detail::LibraryTrot(file));
    else if (kind == "kinematic") motion_.reset(new detail::KinematicTrot(file));
    else if (kind == "none") motion_.reset(new detail::Stand(file));
    else file.blame("has a reference motion of another kind: " + kind);
    if (names_.size() != kJoints) file.blame("has not 12 joints");
    load_observation(file);
  }

  /// Finds how each observation entry is read; NAME@K is an entry's change over K ticks.
  void load_observation(detail::File& file) {
    const std::pair<const char*, std::size_t> known[] = {
        {"command", 3}, {"phase", 2}, {"joint_position", 12}, {"joint_velocity", 12}, {"up", 3},
        {"angular_velocity", 3}, {"last_action", 12}};
    constexpr std::size_t kinds = 7, nowhere = ~std::size_t{0};
    std::size_t places[kinds];
    std::fill_n(places, kinds, nowhere);
    for (const std::string& name : file.texts("observation.name")) {
      const std::size_t at = name.find('@');
      std::size_t from = 0, k = 0;
      while (k < kinds && name.compare(0, at, known[k].first) != 0) from += known[k++].second;
      if (k == kinds) return file.blame("the policy sees " + name + ", which Python code of its task computes");
      if (at == std::string::npos) {
        places[k] = frame_size_;
        frame_size_ += known[k].second;
        for (std::size_t i = 0; i < known[k].second; ++i) sources_.push_back(from + i);
      } else {
        changes_.push_back({std::strtoul(name.c_str() + at + 1, nullptr, 10), k, known[k].second});
      }
    }
    std::size_t size = frame_size_;
    for (Change& change : changes_) {
      change.place = places[change.place];
      const bool known_change = change.place != nowhere && change.ticks >= 1 && change.ticks <= 10000;
      if (!known_change) return file.blame("has a change that cannot be");
      longest_ = std::max(longest_, change.ticks);
      size += change.size;
    }
    if (size != network_.inputs_) return file.blame("has an observation that the network does not read");
    past_.resize((longest_ + 1) * frame_size_);
    seen_.resize(size);
  }

  /// Tries the reference motion at many commands and phases, and the network.
  void try_all(detail::File& file) {
    constexpr int played = 12, ticks = 20;
    for (int i = 0; i < played * played; ++i) {
      Vector command;
      for (std::size_t j = 0; j < 3; ++j) command[j] = least_[j] + (most_[j] - least_[j]) * (i / played) / (played - 1);
      const detail::Pose pose = motion_->pose(command, static_cast<double>(i % played) / played);
      watchdog_.check_targets(pose.position, pose.velocity, pose.position);
    }
    if (watchdog_.fault) return file.blame("has a reference motion that cannot be");
    reset();
    const Measurement still{stand_, {}, {0.0, 0.0, 1.0}, {}, 0.0};
    for (int i = 0; i < ticks; ++i) act(reinterpret_cast<const double*>(&still));
    if (watchdog_.fault) file.blame(std::string("has a policy whose answer cannot be: ") + fault());
    reset();
  }

  void act(const double* measured) {
    const Vector command = {command_[0], command_[1], command_[2]};
    observe(measured, clock_at_rest_ ? 1.0 : motion_->stepping(command));
    const float* answer = network_(seen_.data());
    const bool finite = std::all_of(answer, answer + kJoints, [](float x) { return std::isfinite(x); });
    if (!finite && !watchdog_.stop(kNetwork)) return;
    phase_ = std::fmod(phase_ + dt_ * motion_->phase_rate(command), 1.0);
    Targets next{stand_, {}};
    if (residual_) {
      const detail::Pose pose = motion_->pose(command, phase_);
      for (std::size_t i = 0; i < kJoints; ++i) next.position[i] = pose.position[i] + feedforward_ * pose.torque[i];
      next.velocity = pose.velocity;
    }
    for (std::size_t i = 0; i < kJoints; ++i) {
      last_action_[i] = detail::clip(answer[i], -limit_, limit_);
      next.position[i] = within_range(i, next.position[i] + scale_ * static_cast<double>(last_action_[i]));
    }
    if (watchdog_.check_targets(next.position, next.velocity, targets_.position)) targets_ = next;
  }

  /// Makes the observation: the entries, then their changes.
  void observe(const double* measured, double hand) {
    Moment moment;
    float* to = std::copy(command_.begin(), command_.end(), moment.data());
    const double angle = 2.0 * kPi * phase_;
    *to++ = static_cast<float>(hand * std::sin(angle));
    *to++ = static_cast<float>(hand * std::cos(angle));
    for (std::size_t i = 0; i < 30; ++i) *to++ = static_cast<float>(i < kJoints ? measured[i] - stand_[i] : measured[i]);
    std::copy(last_action_.begin(), last_action_.end(), to);
    const std::size_t rows = longest_ + 1;
    float* frame = &past_[frames_ % rows * frame_size_];
    for (std::size_t i = 0; i < frame_size_; ++i) seen_[i] = frame[i] = moment[sources_[i]];
    float* seen = seen_.data() + frame_size_;
    for (const Change& change : changes_) {
      const bool there = change.ticks <= frames_;
      const float* before = there ? &past_[(frames_ - change.ticks) % rows * frame_size_] : frame;
      for (std::size_t i = 0; i < change.size; ++i) *seen++ = frame[change.place + i] - before[change.place + i];
    }
    ++frames_;
  }

  /// The next targets on a cubic path to the standing pose, which starts and ends at rest.
  Targets to_stand() {
    const double time = watchdog_.stand_time, s = std::min(ticks_stopped_ * dt_ / time, 1.0);
    ++ticks_stopped_;
    Targets next;
    for (std::size_t i = 0; i < kJoints; ++i) {
      const double way = stand_[i] - stopped_at_[i];
      next.position[i] = within_range(i, stopped_at_[i] + way * s * s * (3.0 - 2.0 * s));
      next.velocity[i] = detail::clip(way * (6.0 * s * (1.0 - s) / time), -watchdog_.joint_speed, watchdog_.joint_speed);
    }
    return next;
  }

  double within_range(std::size_t joint, double position) const {
    return detail::clip(position, range_[2 * joint], range_[2 * joint + 1]);
  }

  std::vector<std::string> names_;
  Joints sign_, offset_, stand_;
  std::array<double, 24> range_;
  Vector least_, most_;
  double dt_, scale_, stiffness_, damping_, feedforward_;
  float limit_, launching_, launching_speed_, braking_, stopping_time_, ease_;
  bool residual_, clock_at_rest_;
  detail::Network network_;
  detail::Watchdog watchdog_;
  std::unique_ptr<detail::Motion> motion_;
  std::vector<std::size_t> sources_;  // of the frame's numbers in a `Moment`
  std::vector<Change> changes_;
  std::size_t frame_size_ = 0, longest_ = 0, frames_ = 0;
  std::vector<float> past_, seen_;  // a ring of frames; the observation
  double phase_ = 0.0, ticks_stopped_ = 0.0;
  std::array<float, kJoints> last_action_{};
  std::array<float, 3> command_{};
  Targets targets_{};
  Joints stopped_at_{};
};

}  // namespace bp2
