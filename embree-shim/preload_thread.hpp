// What one thread of the program asks, on its way into the thread's slot. Nothing here locks or allocates, but for a thread's
// first query and its first query of a scene after a commit.
#pragma once

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

struct Thread;

// A call of Embree under way. Calls nest: a callback of the program may ask again.
struct Frame {
  Thread* thread;
  const Capture* capture;
  Frame* outer;
  std::uint32_t first_rejected;  // in the thread's list; what comes before is of outer calls
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

  std::uint32_t number;
  std::uint32_t rejected_count;
  std::uint64_t sequence;
  ExchangeSlot* slot;
  Frame* frame;
  std::uint64_t crowded_since;  // queries for which there was no slot
  Known known[known_scenes];
  Rejected rejected[most_rejected];

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

// Adds a record of a ray that was answered, while its call is the thread's frame. `rejects` are those of this ray.
template <typename At>
void record(Thread& thread, const Thread::Known& scene, bool closest, bool coherent, At at, float asked_tfar,
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
  const float end = value<float>(at, tfar);
  if (closest) {
    record.kind = shim::kind_closest_hit;
    const auto geometry = value<std::uint32_t>(at, hit_geometry);
    // A program may ask again with the hit of before.
    if (geometry != RTC_INVALID_GEOMETRY_ID && (geometry != geometry_before || end != asked_tfar)) {
      flags |= shim::flag_hit;
      record.t = end;
      const auto u = value<float>(at, hit_u);
      const auto v = value<float>(at, hit_v);
      const Capture::Found found = scene.capture->triangle(value<std::uint32_t>(at, hit_instance), geometry,
                                                           value<std::uint32_t>(at, hit_primitive), u, v);
      record.triangle = found.triangle;
      record.u = found.second ? 1.0f - u : u;
      record.v = found.second ? 1.0f - v : v;
      if (found.triangle == shim::no_triangle || found.moves) flags |= shim::flag_undecided;
    }
  } else {
    record.kind = shim::kind_occlusion;
    if (end == -shim::infinity && asked_tfar != -shim::infinity) {
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
