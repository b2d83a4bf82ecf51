// What one thread of the program asks, on its way into the thread's slot. Nothing here locks or allocates, but for a thread's
// first query and its first query of a scene after a commit.
#pragma once

#include <cstdint>

#include "asking.hpp"
#include "preload_exchange.hpp"
#include "preload_scenes.hpp"

namespace preload {

struct Thread;

// A call under way, and what is known of the scene that it asks.
struct Frame : shim::asking::Frame {
  Thread* thread = nullptr;
  const Capture* capture = nullptr;
  Frame* outer = nullptr;
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

  std::uint32_t number;
  std::uint64_t sequence;
  ExchangeSlot* slot;
  Frame* frame;
  std::uint64_t crowded_since;  // queries for which there was no slot
  Known known[known_scenes];
  shim::asking::Candidates candidates;

  const Known* find(RTCScene scene) noexcept;
  // Room for a record; null when there is none.
  ExchangeSlot* room(std::uint32_t rejects) noexcept;
};

// The calling thread's, made at its first query; null when this process is not recorded.
Thread* this_thread() noexcept;

// Adds a record of the ray in lane `lane`, which was answered, while its call is the thread's
// frame. `rejects` are those of this ray.
template <typename At>
void record(Thread& thread, const Thread::Known& scene, unsigned lane, bool closest, bool coherent, At at, float asked_tfar,
            std::uint32_t geometry_before, const shim::asking::Rejected* rejects, std::uint32_t reject_count) noexcept {
  ExchangeSlot* slot = thread.room(reject_count);
  if (slot == nullptr) return;
  const std::uint32_t index = slot->count;
  ShimRecord& record = slot->records[index];
  record.path = shim::no_path;
  record.depth = thread.frame->outer == nullptr ? shim::no_depth : static_cast<std::uint8_t>(EXCHANGE_NESTED);
  record.purpose = shim::purpose_unknown;
  const bool interrupted = shim::asking::answer(record, *thread.frame, *scene.capture, lane, closest, coherent, at, asked_tfar,
                                                geometry_before, reject_count != 0);
  if (interrupted) {
    if (ExchangeHeader* header = exchange()) add(header->interrupted, std::uint64_t{1});
  }
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
