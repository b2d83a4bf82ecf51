// The mapping: opened at the first call of Embree, from the path that embree-trace put in the environment. It leads to a file
// without a name, so nothing is left behind, and a program that closes the descriptors it inherited does not lose it.
#include "preload_exchange.hpp"

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <ctime>

namespace preload {
namespace {

constexpr const char* variable = "EMBREE_TRACE_EXCHANGE";

constexpr std::size_t numbers_offset = (sizeof(ExchangeHeader) + 63) / 64 * 64;
constexpr std::size_t captures_offset = numbers_offset + EXCHANGE_SCENES * sizeof(std::uint32_t);
constexpr std::size_t slots_offset = captures_offset + EXCHANGE_CAPTURES;
constexpr std::size_t mapping_bytes = slots_offset + EXCHANGE_SLOTS * sizeof(ExchangeSlot);
static_assert(sizeof(pthread_mutex_t) <= sizeof(ExchangeSlot::lock));
static_assert(offsetof(ExchangeSlot, lock) % alignof(pthread_mutex_t) == 0);
static_assert(slots_offset % 64 == 0 && sizeof(ExchangeSlot) % 64 == 0 && offsetof(ExchangeSlot, records) == 64);

ExchangeHeader* attach() noexcept {
  const char* path = std::getenv(variable);
  if (path == nullptr) return nullptr;
  auto* header = static_cast<ExchangeHeader*>(map_shared(path, mapping_bytes));
  if (header == nullptr || header->magic != EXCHANGE_MAGIC) {
    std::fprintf(stderr, "embree-trace: warning: %s does not lead to a recording; this process is not recorded\n", variable);
    return nullptr;
  }
  add(header->processes, 1u);
  return header;
}

ExchangeHeader* mapping() noexcept {
  static ExchangeHeader* const header = attach();
  return header;
}

template <typename T>
T* at(std::size_t offset) noexcept {
  return reinterpret_cast<T*>(reinterpret_cast<char*>(mapping()) + offset);
}

ExchangeSlot* slot(std::size_t index) noexcept { return at<ExchangeSlot>(slots_offset) + index; }

pthread_mutex_t* lock_of(ExchangeSlot& slot) noexcept { return reinterpret_cast<pthread_mutex_t*>(slot.lock); }

// Takes a slot's lock if no living thread holds it.
bool try_lock(ExchangeSlot& slot) noexcept {
  switch (pthread_mutex_trylock(lock_of(slot))) {
    case 0: return true;
    case EOWNERDEAD: return pthread_mutex_consistent(lock_of(slot)) == 0;
    default: return false;
  }
}

void unlock(ExchangeSlot& slot) noexcept { pthread_mutex_unlock(lock_of(slot)); }

// Marks a slot as one that its owner has left, with what is in it.
void leave(ExchangeSlot& slot) noexcept {
  const bool empty = load(slot.count) == 0;
  store(slot.state, static_cast<std::uint32_t>(empty ? EXCHANGE_FREE : EXCHANGE_FULL));
}

// Hands over the slots of threads that have ended without doing so: of processes that were killed,
// or left without destructors. Returns whether there was one.
bool hand_over_abandoned() noexcept {
  bool found = false;
  for (std::size_t number = 0; number < EXCHANGE_SLOTS; number++) {
    ExchangeSlot& candidate = *slot(number);
    if (load(candidate.state) != EXCHANGE_OWNED || !try_lock(candidate)) continue;
    // Somebody else may have been faster.
    if (load(candidate.state) == EXCHANGE_OWNED) leave(candidate);
    unlock(candidate);
    found = true;
  }
  return found;
}

void sleep_for_microseconds(long microseconds) noexcept {
  const int saved = errno;
  const timespec time{0, microseconds * 1000};
  nanosleep(&time, nullptr);
  errno = saved;
}

bool collector_lives(const ExchangeHeader& header) noexcept {
  const int saved = errno;
  const bool lives = kill(header.collector, 0) == 0 || errno != ESRCH;
  errno = saved;
  return lives;
}

}  // namespace

void* map_shared(const char* path, std::size_t bytes) noexcept {
  const int saved = errno;
  const int file = open(path, O_RDWR | O_CLOEXEC);
  void* memory = MAP_FAILED;
  struct stat status;
  if (file >= 0 && fstat(file, &status) == 0 && static_cast<std::size_t>(status.st_size) == bytes) {
    memory = mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  }
  if (file >= 0) close(file);
  errno = saved;
  return memory == MAP_FAILED ? nullptr : memory;
}

ExchangeHeader* exchange() noexcept {
  ExchangeHeader* header = mapping();
  return header != nullptr && load(header->stop) == 0 ? header : nullptr;
}

ExchangeSlot* take_slot(std::uint32_t thread, std::uint64_t sequence) noexcept {
  for (unsigned round = 0;; round++) {
    ExchangeHeader* header = exchange();
    if (header == nullptr) return nullptr;
    bool full = false;
    for (std::size_t number = 0; number < EXCHANGE_SLOTS; number++) {
      // Threads start at different slots, so that they seldom meet.
      ExchangeSlot* candidate = slot((number + thread * 7) % EXCHANGE_SLOTS);
      const std::uint32_t state = load(candidate->state);
      full = full || state == EXCHANGE_FULL;
      if (state != EXCHANGE_FREE || !try_lock(*candidate)) continue;
      if (load(candidate->state) != EXCHANGE_FREE) {
        unlock(*candidate);
        continue;
      }
      candidate->thread = thread;
      candidate->sequence = sequence;
      candidate->reject_count = 0;
      store(candidate->count, 0u);
      store(candidate->state, static_cast<std::uint32_t>(EXCHANGE_OWNED));
      return candidate;
    }
    if (!full) {
      if (!hand_over_abandoned()) return nullptr;
      continue;
    }
    // embree-trace is behind, or gone.
    constexpr unsigned rounds_per_check = 256;
    if (round % rounds_per_check == rounds_per_check - 1 && !collector_lives(*header)) {
      store(header->stop, 1u);
      return nullptr;
    }
    sleep_for_microseconds(200);
  }
}

void give_slot(ExchangeSlot* slot) noexcept {
  leave(*slot);
  unlock(*slot);
}

std::uint32_t number_scene(std::uint32_t capture) noexcept {
  ExchangeHeader* header = mapping();
  std::uint32_t number = load(header->scenes);
  // The capture stands there before the count says so, and whoever comes next counts it: a process
  // may be killed between the two.
  for (; number < EXCHANGE_SCENES; number++) {
    std::uint32_t none = 0;
    const bool ours = __atomic_compare_exchange_n(at<std::uint32_t>(numbers_offset) + number, &none, capture + 1, false,
                                                  __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    std::uint32_t before = number;
    __atomic_compare_exchange_n(&header->scenes, &before, number + 1, false, __ATOMIC_ACQ_REL, __ATOMIC_ACQUIRE);
    if (ours) return number;
  }
  return EXCHANGE_SCENES;
}

void set_capture_state(std::uint32_t capture, std::uint8_t state) noexcept {
  store(at<std::uint8_t>(captures_offset)[capture], state);
}

void fail(const char* reason) noexcept {
  ExchangeHeader* header = mapping();
  if (header == nullptr) return;
  std::uint32_t none = 0;
  if (__atomic_compare_exchange_n(&header->failed, &none, 1u, false, __ATOMIC_ACQ_REL, __ATOMIC_RELAXED)) {
    std::snprintf(header->failure, sizeof header->failure, "%s", reason);
    store(header->failed, 2u);
  }
  store(header->stop, 1u);
}

}  // namespace preload
