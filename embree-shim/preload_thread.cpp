// Threads of the program: each gets its object at its first query and gives its slot back when it ends.
#include "preload_thread.hpp"

#include <pthread.h>
#include <sys/mman.h>

#include <new>

namespace preload {
namespace {

// One pointer, in the static block: nothing is allocated for it, and a thread with a small stack stays as it is.
__attribute__((tls_model("initial-exec"))) thread_local Thread* current = nullptr;

pthread_key_t key;

void end(void* object) noexcept {
  auto* thread = static_cast<Thread*>(object);
  current = nullptr;
  if (thread->slot != nullptr) give_slot(thread->slot);
  munmap(thread, sizeof(Thread));
}

// A forked child is another thread to embree-trace; the slot stays the parent's.
void forked() noexcept {
  if (current == nullptr) return;
  ExchangeHeader* header = exchange();
  current->slot = nullptr;
  current->sequence = 0;
  if (header != nullptr) current->number = add(header->threads, 1u);
}

bool prepare() noexcept {
  pthread_atfork(nullptr, nullptr, &forked);
  return pthread_key_create(&key, &end) == 0;
}

Thread* start() noexcept {
  static const bool prepared = prepare();
  ExchangeHeader* header = exchange();
  if (header == nullptr || !prepared) return nullptr;
  void* memory = mmap(nullptr, sizeof(Thread), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) {
    fail("there is no memory left for a thread");
    return nullptr;
  }
  auto* thread = static_cast<Thread*>(memory);  // all zero
  thread->number = add(header->threads, 1u);
  pthread_setspecific(key, thread);
  current = thread;
  return thread;
}

}  // namespace

Thread* this_thread() noexcept { return __builtin_expect(current != nullptr, 1) ? current : start(); }

const Thread::Known* Thread::find(RTCScene scene) noexcept {
  const std::uint64_t now = epoch();
  const auto hash = reinterpret_cast<std::uintptr_t>(scene) >> 6;
  Known& entry = known[(hash ^ hash >> 7) % known_scenes];
  if (__builtin_expect(entry.scene == scene && entry.epoch == now, 1)) return entry.capture == nullptr ? nullptr : &entry;
  entry.scene = scene;
  entry.epoch = now;
  entry.capture = capture_of(scene);
  entry.number = entry.capture == nullptr ? static_cast<std::uint32_t>(EXCHANGE_SCENES) : entry.capture->number();
  if (entry.number == EXCHANGE_SCENES) entry.capture = nullptr;
  return entry.capture == nullptr ? nullptr : &entry;
}

ExchangeSlot* Thread::room(std::uint32_t rejects) noexcept {
  if (slot != nullptr && slot->count < EXCHANGE_RECORDS && slot->reject_count + rejects <= EXCHANGE_REJECTS) return slot;
  if (slot != nullptr) give_slot(slot);
  // Where all slots are owned, looking for one at each query would be slow.
  constexpr std::uint64_t queries_per_look = 1024;
  slot = crowded_since % queries_per_look == 0 ? take_slot(number, sequence) : nullptr;
  if (slot == nullptr) {
    crowded_since++;
    if (ExchangeHeader* header = exchange()) add(header->unrecorded, std::uint64_t{1});
  } else {
    crowded_since = 0;
  }
  return slot;
}

}  // namespace preload
