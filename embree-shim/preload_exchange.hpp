// The program's side of exchange.h: the mapping, its counters, its slots.
#pragma once

#include <cstddef>
#include <cstdint>

#include "exchange.h"

namespace preload {

// Counters and states are plain integers in shared memory, touched by these only.
template <typename T>
T load(const T& place) noexcept {
  return __atomic_load_n(&place, __ATOMIC_ACQUIRE);
}
template <typename T>
void store(T& place, T value) noexcept {
  __atomic_store_n(&place, value, __ATOMIC_RELEASE);
}
template <typename T>
T add(T& place, T value) noexcept {
  return __atomic_fetch_add(&place, value, __ATOMIC_ACQ_REL);
}

// Maps a file of so many bytes that embree-trace shares with its programs, to read and write; null when it is another one, or
// not there. Leaves errno as it is.
void* map_shared(const char* path, std::size_t bytes) noexcept;

// The mapping; null when this process is not recorded, or no longer.
ExchangeHeader* exchange() noexcept;

// A free slot, owned from now on by `thread`. Waits for embree-trace to empty one when it is behind; null when all belong to
// other threads, or recording has ended.
ExchangeSlot* take_slot(std::uint32_t thread, std::uint64_t sequence) noexcept;
// Hands a slot to embree-trace.
void give_slot(ExchangeSlot* slot) noexcept;

// Numbers a capture (exchange.h) that was asked something; returns EXCHANGE_SCENES when there is no number left.
std::uint32_t number_scene(std::uint32_t capture) noexcept;
void set_capture_state(std::uint32_t capture, std::uint8_t state) noexcept;

// Ends the recording of everything, and says why; only the first reason is kept. The program goes on.
void fail(const char* reason) noexcept;

}  // namespace preload
