// What one thread of the program asks, on its way into the thread's slot. Nothing here locks or allocates, but for a thread's
// first query and its first query of a scene after a commit.
#pragma once

#include <cfloat>
#include <cmath>
#include <cstdint>
#include <cstring>

#include "preload_exchange.hpp"
#include "preload_scenes.hpp"
#include "record.hpp"

namespace preload {

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

inline bool is_same(const Hit& a, const Hit& b) noexcept { return std::memcmp(&a, &b, sizeof a) == 0; }

// A candidate that a filter accepted and changed: Embree lets it decrease tfar, and change the hit.
struct Changed {
  std::uint32_t lane;
  Hit before, after;
};

struct Thread;

// A call of Embree under way. Calls nest: a callback of the program may ask again.
struct Frame {
  Thread* thread;
  const Capture* capture;
  Frame* outer;
  std::uint32_t first_rejected;  // in the thread's list; what comes before is of outer calls
  std::uint32_t first_changed;   // the same
  unsigned lanes;
  // Where field `field` of the ray in lane `lane` stands; for more lanes than one.
  const void* rays;
  const float* (*at)(const void* rays, unsigned lane, unsigned field);
};

struct Thread {
  // A scene that was asked lately.
  struct Known {
    RTCScene scene;
    std::uint64_t epoch;
    const Capture* capture;
    std::uint32_t number;
  };
  static constexpr std::size_t known_scenes = 16;
  static constexpr std::uint32_t most_rejected = 8192;
  static constexpr std::uint32_t most_changed = 4096;

  std::uint32_t number;
  std::uint32_t rejected_count;
  std::uint32_t changed_count;
  std::uint64_t sequence;
  ExchangeSlot* slot;
  Frame* frame;
  std::uint64_t crowded_since;  // queries for which there was no slot
  Known known[known_scenes];
  Rejected rejected[most_rejected];
  Changed changed[most_changed];

  const Known* find(RTCScene scene) noexcept;
  // Room for a record; null when there is none.
  ExchangeSlot* room(std::uint32_t rejects) noexcept;
};

// The calling thread's, made at its first query; null when this process is not recorded.
Thread* this_thread() noexcept;

// One ray of a call: `at(field)` is where its field stands, counted in the order of RTCRay and RTCHit.
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

template <typename At>
Hit hit_of(At at) noexcept {
  return {value<float>(at, tfar),
          value<float>(at, hit_u),
          value<float>(at, hit_v),
          value<std::uint32_t>(at, hit_primitive),
          value<std::uint32_t>(at, hit_geometry),
          value<std::uint32_t>(at, hit_instance)};
}

inline bool has_same_bits(float a, float b) noexcept { return std::memcmp(&a, &b, sizeof a) == 0; }

// Whether a filter has changed where the ray in lane `lane` of the thread's frame ends: then Embree
// may have left out what is closer.
inline bool is_interrupted(const Thread& thread, unsigned lane) noexcept {
  if (__builtin_expect(thread.changed_count == thread.frame->first_changed, 1)) return false;
  // Then there may be more.
  if (thread.changed_count == Thread::most_changed) return true;
  for (std::uint32_t number = thread.frame->first_changed; number < thread.changed_count; number++) {
    const Changed& changed = thread.changed[number];
    if (changed.lane == lane && !has_same_bits(changed.before.t, changed.after.t)) return true;
  }
  return false;
}

// What Embree found where the program's filters have made `hit` of it.
inline Hit unchanged(const Thread& thread, unsigned lane, const Hit& hit) noexcept {
  for (std::uint32_t number = thread.frame->first_changed; number < thread.changed_count; number++) {
    const Changed& changed = thread.changed[number];
    if (changed.lane == lane && is_same(changed.after, hit)) return changed.before;
  }
  return hit;
}

// Adds a record of the ray in lane `lane`, which was answered, while its call is the thread's
// frame. `rejects` are those of this ray.
template <typename At>
void record(Thread& thread, const Thread::Known& scene, unsigned lane, bool closest, bool coherent, At at, float asked_tfar,
            std::uint32_t geometry_before, const Rejected* rejects, std::uint32_t reject_count) noexcept {
  ExchangeSlot* slot = thread.room(reject_count);
  if (slot == nullptr) return;
  const std::uint32_t index = slot->count;
  ShimRecord& record = slot->records[index];
  for (unsigned axis = 0; axis < 3; axis++) {
    record.origin[axis] = value<float>(at, origin + axis);
    record.direction[axis] = value<float>(at, direction + axis);
  }
  record.tnear = value<float>(at, tnear);
  record.tfar = asked_tfar;
  record.time = value<float>(at, time);
  record.mask = value<std::uint32_t>(at, mask);
  record.t = shim::infinity;
  record.triangle = shim::no_triangle;
  record.u = 0.0f;
  record.v = 0.0f;
  record.path = shim::no_path;
  record.depth = thread.frame->outer == nullptr ? shim::no_depth : static_cast<std::uint8_t>(EXCHANGE_NESTED);
  record.purpose = shim::purpose_unknown;
  std::uint8_t flags = coherent ? shim::flag_coherent : 0;
  if (closest) {
    record.kind = shim::kind_closest_hit;
    const auto geometry = value<std::uint32_t>(at, hit_geometry);
    const bool ends_elsewhere = !has_same_bits(value<float>(at, tfar), asked_tfar);
    bool interrupted = is_interrupted(thread, lane);
    // A program may ask again with the hit of before.
    if (geometry != RTC_INVALID_GEOMETRY_ID && (geometry != geometry_before || ends_elsewhere || interrupted)) {
      flags |= shim::flag_hit;
      const Hit hit = unchanged(thread, lane, hit_of(at));
      record.t = hit.t;
      if (!std::isfinite(hit.t)) {
        // A callback of a user geometry has ended the ray, or hit at no distance.
        interrupted = true;
        record.t = hit.t > 0 ? FLT_MAX : std::isfinite(record.tnear) ? record.tnear : 0.0f;
      }
      const Capture::Found found = scene.capture->triangle(hit.instance, hit.geometry, hit.primitive, hit.u, hit.v);
      record.triangle = found.triangle;
      record.u = found.second ? 1.0f - hit.u : hit.u;
      record.v = found.second ? 1.0f - hit.v : hit.v;
      if (found.triangle == shim::no_triangle || found.moves) flags |= shim::flag_undecided;
    } else {
      // Ended, and nothing hit.
      interrupted = interrupted || ends_elsewhere;
    }
    if (interrupted) {
      flags |= shim::flag_interrupted | shim::flag_undecided;
      if (ExchangeHeader* header = exchange()) add(header->interrupted, std::uint64_t{1});
    }
  } else {
    record.kind = shim::kind_occlusion;
    if (value<float>(at, tfar) == -shim::infinity && asked_tfar != -shim::infinity) {
      flags |= shim::flag_hit;
      record.t = -shim::infinity;
      // It is not known by what.
      if (scene.capture->is_undecided()) flags |= shim::flag_undecided;
    }
  }
  if (reject_count != 0) flags |= shim::flag_has_rejects;
  record.flags = flags;
  slot->scenes[index] = static_cast<std::uint16_t>(scene.number);
  for (std::uint32_t reject = 0; reject < reject_count; reject++) {
    slot->rejects[slot->reject_count + reject][0] = index;
    slot->rejects[slot->reject_count + reject][1] = rejects[reject].triangle;
  }
  slot->reject_count += reject_count;
  thread.sequence++;
  // After everything else: embree-trace may read at any moment.
  store(slot->count, index + 1);
}

}  // namespace preload
