// A call that asks Embree, as those see it who stand between a program and Embree: its rays ->
// Embree -> a record of each ray and its answer, with the candidates that the program's filters
// refuse or change. The preload library is one of them (preload_call.hpp), the library that a
// renderer is linked with the other (host_recording.cpp).
//
// All forms of a ray, one, packets and streams, have their fields in the same order, so that one
// template serves them: it is given where field f of lane i stands. The program's memory is read,
// never written.
#pragma once

#include <algorithm>
#include <cfloat>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "embree3.hpp"
#include "record.hpp"

namespace shim::asking {

// One ray of a call: `at(field)` is where its field stands, counted in the order of RTCRay and
// RTCHit.
enum Field : unsigned {
  origin = 0,
  tnear = 3,
  direction = 4,
  time = 7,
  tfar = 8,
  mask = 9,
  hit_u = 15,
  hit_v = 16,
  hit_primitive = 17,
  hit_geometry = 18,
  hit_instance = 19,
};

template <typename T, typename At>
T value(At at, unsigned field) noexcept {
  T value;
  std::memcpy(&value, at(field), sizeof value);
  return value;
}

inline const float* field_of(const void* ray, unsigned field) noexcept {
  return static_cast<const float*>(ray) + field;
}

inline bool has_same_bits(float a, float b) noexcept { return std::memcmp(&a, &b, sizeof a) == 0; }

// A candidate that a filter rejected, of one of the rays that are being asked.
struct Rejected {
  std::uint32_t lane;
  std::uint32_t triangle;
};

// What was hit, as a ray or a filter's arguments say it.
struct Hit {
  float t;
  float u, v;
  std::uint32_t primitive, geometry, instance;
};

inline bool is_same(const Hit& a, const Hit& b) noexcept {
  return std::memcmp(&a, &b, sizeof a) == 0;
}

template <typename At>
Hit hit_of(At at) noexcept {
  return {value<float>(at, tfar),
          value<float>(at, hit_u),
          value<float>(at, hit_v),
          value<std::uint32_t>(at, hit_primitive),
          value<std::uint32_t>(at, hit_geometry),
          value<std::uint32_t>(at, hit_instance)};
}

// A candidate that a filter accepted and changed: Embree lets it decrease tfar, and change the hit.
struct Changed {
  std::uint32_t lane;
  Hit before, after;
};

// A hit's triangle. The numbering that a record is made with has, beside `is_undecided`, a function
// `triangle(instance, geometry, primitive, u, v)` that finds it.
struct Found {
  std::uint32_t triangle;  // index in TRIS, or no_triangle when it is something else
  bool second;             // the second half of a quad: u and v are to be turned
  bool moves;
};

// What filters did to candidates of the calls that a thread has under way, to those of inner calls
// last. All zero at first.
struct Candidates {
  static constexpr std::uint32_t most_rejected = 8192;
  static constexpr std::uint32_t most_changed = 4096;

  std::uint32_t rejected_count;
  std::uint32_t changed_count;
  Rejected rejected[most_rejected];
  Changed changed[most_changed];
};

// A call of Embree under way. Calls nest: a callback of the program may ask again.
struct Frame {
  Candidates* candidates = nullptr;
  std::uint32_t first_rejected = 0;  // what comes before is of outer calls
  std::uint32_t first_changed = 0;   // the same
  std::uint32_t next_rejected = 0;   // of the next lane to be recorded, once they are sorted
  unsigned lanes = 1;
  // Where field `field` of the ray in lane `lane` stands; for more lanes than one.
  const void* rays = nullptr;
  const float* (*at)(const void* rays, unsigned lane, unsigned field) = nullptr;

  void begin(Candidates& of_thread) noexcept {
    candidates = &of_thread;
    first_rejected = next_rejected = of_thread.rejected_count;
    first_changed = of_thread.changed_count;
  }

  // Tells filters which rays are being asked.
  template <typename At>
  void expect(unsigned count, const At& where) noexcept {
    lanes = count;
    rays = &where;
    at = [](const void* rays, unsigned lane, unsigned field) {
      return (*static_cast<const At*>(rays))(lane, field);
    };
  }

  // Puts the rejects of a packet or block in the order of its lanes, before its records are made.
  void sort() noexcept {
    Rejected* rejected = candidates->rejected;
    std::sort(rejected + first_rejected, rejected + candidates->rejected_count,
              [](const Rejected& a, const Rejected& b) { return a.lane < b.lane; });
    next_rejected = first_rejected;
  }

  // The rejects of a lane. Lanes come in order.
  const Rejected* take_rejects(unsigned lane, std::uint32_t& count) noexcept {
    const std::uint32_t first = next_rejected;
    while (next_rejected < candidates->rejected_count &&
           candidates->rejected[next_rejected].lane == lane)
      next_rejected++;
    count = next_rejected - first;
    return candidates->rejected + first;
  }

  // What filters did: before the next block, and at the end.
  void forget() noexcept {
    candidates->rejected_count = next_rejected = first_rejected;
    candidates->changed_count = first_changed;
  }
};

// Whether a filter has changed where the ray in a lane ends: then Embree may have left out what is
// closer.
inline bool is_interrupted(const Frame& frame, unsigned lane) noexcept {
  const Candidates& candidates = *frame.candidates;
  if (__builtin_expect(candidates.changed_count == frame.first_changed, 1)) return false;
  // Then there may be more.
  if (candidates.changed_count == Candidates::most_changed) return true;
  for (std::uint32_t number = frame.first_changed; number < candidates.changed_count; number++) {
    const Changed& changed = candidates.changed[number];
    if (changed.lane == lane && !has_same_bits(changed.before.t, changed.after.t)) return true;
  }
  return false;
}

// What Embree found where the program's filters have made `hit` of it.
inline Hit unchanged(const Frame& frame, unsigned lane, const Hit& hit) noexcept {
  for (std::uint32_t number = frame.first_changed; number < frame.candidates->changed_count;
       number++) {
    const Changed& changed = frame.candidates->changed[number];
    if (changed.lane == lane && is_same(changed.after, hit)) return changed.before;
  }
  return hit;
}

// Fills a record of the ray in lane `lane`, which was answered: all but path, depth and purpose.
// Returns whether the program itself has changed where the ray ends.
template <typename Numbering, typename At>
bool answer(ShimRecord& record, const Frame& frame, const Numbering& numbering, unsigned lane,
            bool closest, bool coherent, At at, float asked_tfar, std::uint32_t geometry_before,
            bool has_rejects) noexcept {
  for (unsigned axis = 0; axis < 3; axis++) {
    record.origin[axis] = value<float>(at, origin + axis);
    record.direction[axis] = value<float>(at, direction + axis);
  }
  record.tnear = value<float>(at, tnear);
  record.tfar = asked_tfar;
  record.time = value<float>(at, time);
  record.mask = value<std::uint32_t>(at, mask);
  record.t = infinity;
  record.triangle = no_triangle;
  record.u = 0.0f;
  record.v = 0.0f;
  std::uint8_t flags = coherent ? flag_coherent : 0;
  bool interrupted = false;
  if (closest) {
    record.kind = kind_closest_hit;
    const auto geometry = value<std::uint32_t>(at, hit_geometry);
    const bool ends_elsewhere = !has_same_bits(value<float>(at, tfar), asked_tfar);
    interrupted = is_interrupted(frame, lane);
    // A program may ask again with the hit of before.
    if (geometry != RTC_INVALID_GEOMETRY_ID &&
        (geometry != geometry_before || ends_elsewhere || interrupted)) {
      flags |= flag_hit;
      const Hit hit = unchanged(frame, lane, hit_of(at));
      record.t = hit.t;
      if (!std::isfinite(hit.t)) {
        // A callback of a user geometry has ended the ray, or hit at no distance.
        interrupted = true;
        record.t = hit.t > 0 ? FLT_MAX : std::isfinite(record.tnear) ? record.tnear : 0.0f;
      }
      const Found found =
          numbering.triangle(hit.instance, hit.geometry, hit.primitive, hit.u, hit.v);
      record.triangle = found.triangle;
      record.u = found.second ? 1.0f - hit.u : hit.u;
      record.v = found.second ? 1.0f - hit.v : hit.v;
      if (found.triangle == no_triangle || found.moves) flags |= flag_undecided;
    } else {
      // Ended, and nothing hit.
      interrupted = interrupted || ends_elsewhere;
    }
    if (interrupted) flags |= flag_interrupted | flag_undecided;
  } else {
    record.kind = kind_occlusion;
    if (value<float>(at, tfar) == -infinity && asked_tfar != -infinity) {
      flags |= flag_hit;
      record.t = -infinity;
      // It is not known by what.
      if (numbering.is_undecided()) flags |= flag_undecided;
    }
  }
  if (has_rejects) flags |= flag_has_rejects;
  record.flags = flags;
  return interrupted;
}

// One ray; `closest` asks for the nearest hit, and `ask` Embree. A call has, beside what it passes
// on to its frame, `record(lane, closest, at, asked_tfar, geometry_before)`.
template <bool closest, typename Call, typename Ask>
void single(Call& call, const void* ray, Ask ask) {
  const auto at = [ray](unsigned field) { return field_of(ray, field); };
  const auto asked_tfar = value<float>(at, tfar);
  const std::uint32_t before = closest ? value<std::uint32_t>(at, hit_geometry) : 0;
  ask();
  if (call.recorded()) call.record(0, closest, at, asked_tfar, before);
}

// Asks `lanes` rays with `ask`; `at(lane, field)` is where a field stands, `active(lane)` whether
// the ray is one.
template <unsigned most, bool closest, typename Call, typename At, typename Active, typename Ask>
void ask_block(Call& call, unsigned lanes, At at, Active active, Ask ask) {
  float asked_tfar[most];
  std::uint32_t before[most];
  bool asked[most];
  for (unsigned lane = 0; lane < lanes; lane++) {
    asked[lane] = active(lane);
    std::memcpy(&asked_tfar[lane], at(lane, tfar), sizeof(float));
    if (closest) std::memcpy(&before[lane], at(lane, hit_geometry), sizeof(std::uint32_t));
  }
  Frame& frame = call.frame();
  frame.expect(lanes, at);
  ask();
  frame.sort();
  for (unsigned lane = 0; lane < lanes; lane++) {
    if (!asked[lane]) continue;
    call.record(
        lane, closest, [&](unsigned field) { return at(lane, field); }, asked_tfar[lane],
        closest ? before[lane] : 0);
  }
  frame.forget();
}

template <unsigned width, bool closest, typename Call, typename Ask>
void packet(Call& call, const int* valid, const void* rays, Ask ask) {
  if (!call.recorded()) return ask();
  const auto at = [rays](unsigned lane, unsigned field) {
    return field_of(rays, field * width + lane);
  };
  ask_block<width, closest>(
      call, width, at, [valid](unsigned lane) { return valid[lane] == -1; }, ask);
}

}  // namespace shim::asking
