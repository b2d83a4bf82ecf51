// Takes the time of calls that ask, for `embree-trace tune`: every call is counted, and the time of one in 64 is taken, at
// random, so that the clock costs next to nothing and meets no rhythm of the program's.
//
// Each thread has rows of its own in a mapping that embree-trace reads in the end, one for each scene. The time of a call counts for
// as many calls as one of its kind is taken of: so the sum is an estimate of the time of all, without bias.
//
// Calls have Embree 3's prototypes. Those of Embree 4 have as many pointers, in the same registers, and nothing but the scene is
// looked at.
#include <pthread.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>

#include "preload_exchange.hpp"
#include "preload_scenes.hpp"

namespace preload {
namespace {

constexpr const char* variable = "EMBREE_TRACE_CLOCKS";
constexpr std::size_t mapping_bytes = sizeof(ExchangeClocks) + EXCHANGE_CLOCKS * sizeof(ExchangeClock);
static_assert(sizeof(ExchangeClocks) == 128 && sizeof(ExchangeClock) == 128);

// Calls of one kind for each whose time is taken, in the mean.
constexpr std::uint64_t calls_per_timed = 64;
// A call of so many rays is always timed: the clock costs it nothing.
constexpr std::uint64_t many_rays = 256;

ExchangeClocks* attach_clocks() noexcept {
  const char* path = std::getenv(variable);
  if (path == nullptr) return nullptr;
  auto* clocks = static_cast<ExchangeClocks*>(map_shared(path, mapping_bytes));
  if (clocks == nullptr || clocks->magic != EXCHANGE_MAGIC) {
    std::fprintf(stderr, "embree-trace: warning: %s does not lead to clocks; this process is not timed\n", variable);
    return nullptr;
  }
  return clocks;
}

ExchangeClocks* clocks() noexcept {
  static ExchangeClocks* const clocks = attach_clocks();
  return clocks;
}

std::uint64_t now() noexcept {
  timespec time{};
  clock_gettime(CLOCK_MONOTONIC, &time);
  return static_cast<std::uint64_t>(time.tv_sec) * 1000000000u + static_cast<std::uint64_t>(time.tv_nsec);
}

// What looking at the clock twice takes.
std::uint64_t time_of_clock() noexcept {
  std::uint64_t least = ~std::uint64_t{0};
  for (unsigned round = 0; round < 64; round++) {
    const std::uint64_t started = now();
    least = std::min(least, now() - started);
  }
  return least;
}

// The row's owner alone writes it; embree-trace may read it at any moment.
void add_to(std::uint64_t& count, std::uint64_t more) noexcept {
  __atomic_store_n(&count, __atomic_load_n(&count, __ATOMIC_RELAXED) + more, __ATOMIC_RELAXED);
}

// A thread that asks.
struct Asker {
  struct Known {
    RTCScene scene;
    std::uint64_t epoch;
    ExchangeClock* row;
  };
  static constexpr std::size_t known_scenes = 16;
  static constexpr std::size_t most_rows = 1024;

  Known known[known_scenes];
  std::uint64_t random;
  std::uint64_t wait[2];  // calls of a kind up to the next that is timed
  std::uint64_t clock;    // nanoseconds that looking at the clock twice takes
  bool inside;            // a callback of a call that is timed may ask, too
  ExchangeClock* rows[most_rows];
  std::size_t row_count;

  // Uniform from 1 to 2 n - 1, so n in the mean.
  std::uint64_t next_wait() noexcept {
    random ^= random << 13;
    random ^= random >> 7;
    random ^= random << 17;
    return 1 + random % (2 * calls_per_timed - 1);
  }

  ExchangeClock* row_of(RTCScene scene) noexcept {
    const auto hash = reinterpret_cast<std::uintptr_t>(scene) >> 6;
    Known& entry = known[(hash ^ hash >> 7) % known_scenes];
    const std::uint64_t current = epoch();
    if (__builtin_expect(entry.scene != scene || entry.epoch != current, 0)) entry = {scene, current, find(scene)};
    return entry.row;
  }

 private:
  // The thread's row for the scene as it is now, or a new one; null when there is none left.
  ExchangeClock* find(RTCScene scene) noexcept {
    Identity identity{0, 0};
    if (!identify(scene, identity)) return nullptr;
    const auto is_it = [&](const ExchangeClock* row) { return row->scene == identity.scene && row->geometry == identity.geometry; };
    ExchangeClock** last = rows + row_count;
    ExchangeClock** found = std::find_if(rows, last, is_it);
    if (found != last) return *found;
    const std::uint32_t index = __atomic_fetch_add(&clocks()->count, 1u, __ATOMIC_RELAXED);
    if (index >= EXCHANGE_CLOCKS) return nullptr;
    auto* row = reinterpret_cast<ExchangeClock*>(clocks() + 1) + index;
    row->scene = identity.scene;
    row->geometry = identity.geometry;
    __atomic_store_n(&row->process, static_cast<std::uint32_t>(getpid()), __ATOMIC_RELEASE);
    if (row_count < most_rows) rows[row_count++] = row;
    return row;
  }
};

// One pointer, in the static block: a thread with a small stack stays as it is.
__attribute__((tls_model("initial-exec"))) thread_local Asker* current = nullptr;

pthread_key_t key;

void end(void* asker) noexcept {
  current = nullptr;
  munmap(asker, sizeof(Asker));
}

// The rows stay the parent's.
void forked() noexcept {
  if (current == nullptr) return;
  for (Asker::Known& known : current->known) known = {};
  current->row_count = 0;
}

bool prepare() noexcept {
  pthread_atfork(nullptr, nullptr, &forked);
  return pthread_key_create(&key, &end) == 0;
}

Asker* start() noexcept {
  static const bool prepared = prepare();
  if (clocks() == nullptr || !real().is_known() || !prepared) return nullptr;
  void* memory = mmap(nullptr, sizeof(Asker), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) return nullptr;
  auto* asker = static_cast<Asker*>(memory);  // all zero
  asker->clock = time_of_clock();
  asker->random = (reinterpret_cast<std::uintptr_t>(memory) ^ now()) | 1;
  for (std::uint64_t& wait : asker->wait) wait = asker->next_wait();
  pthread_setspecific(key, asker);
  current = asker;
  return asker;
}

// A thread that is held up for another, or waits for memory from disk, is not in Embree meanwhile.
bool is_interrupted(std::uint64_t nanoseconds, std::uint64_t rays) noexcept { return nanoseconds > 1000000 + 10000 * rays; }

template <typename Ask>
void timed(RTCScene scene, unsigned kind, std::uint64_t rays, Ask ask) noexcept {
  Asker* asker = __builtin_expect(current != nullptr, 1) ? current : start();
  ExchangeClock* row = asker == nullptr ? nullptr : asker->row_of(scene);
  if (row == nullptr) return ask();
  add_to(row->calls[kind], 1);
  add_to(row->rays[kind], rays);
  if (asker->inside) return ask();
  std::uint64_t counts_for = 1;
  if (rays < many_rays) {
    if (__builtin_expect(--asker->wait[kind] != 0, 1)) return ask();
    asker->wait[kind] = asker->next_wait();
    counts_for = calls_per_timed;
  }
  asker->inside = true;
  const std::uint64_t started = now();
  ask();
  const std::uint64_t whole = now() - started;
  asker->inside = false;
  const std::uint64_t took = whole - std::min(whole, asker->clock);
  if (is_interrupted(took, rays)) return;
  add_to(row->timed[kind], 1);
  add_to(row->nanoseconds[kind], took * counts_for);
}

template <unsigned width>
std::uint64_t valid_rays(const int* valid) noexcept {
  return static_cast<std::uint64_t>(std::count(valid, valid + width, -1));
}

constexpr unsigned closest_hit = EXCHANGE_CLOSEST_HIT;
constexpr unsigned occlusion = EXCHANGE_OCCLUSION;

}  // namespace
}  // namespace preload

using namespace preload;

void rtcIntersect1(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit) {
  timed(scene, closest_hit, 1, [=] { real().rtcIntersect1(scene, context, rayhit); });
}

void rtcOccluded1(RTCScene scene, RTCIntersectContext* context, RTCRay* ray) {
  timed(scene, occlusion, 1, [=] { real().rtcOccluded1(scene, context, ray); });
}

#define PRELOAD_PACKET(width)                                                                                              \
  void rtcIntersect##width(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRayHit##width* rayhit) {     \
    timed(scene, closest_hit, valid_rays<width>(valid), [=] { real().rtcIntersect##width(valid, scene, context, rayhit); }); \
  }                                                                                                                        \
  void rtcOccluded##width(const int* valid, RTCScene scene, RTCIntersectContext* context, RTCRay##width* ray) {            \
    timed(scene, occlusion, valid_rays<width>(valid), [=] { real().rtcOccluded##width(valid, scene, context, ray); });     \
  }
PRELOAD_PACKET(4)
PRELOAD_PACKET(8)
PRELOAD_PACKET(16)
#undef PRELOAD_PACKET

void rtcIntersect1M(RTCScene scene, RTCIntersectContext* context, RTCRayHit* rayhit, unsigned int M, size_t byteStride) {
  timed(scene, closest_hit, M, [=] { real().rtcIntersect1M(scene, context, rayhit, M, byteStride); });
}

void rtcOccluded1M(RTCScene scene, RTCIntersectContext* context, RTCRay* ray, unsigned int M, size_t byteStride) {
  timed(scene, occlusion, M, [=] { real().rtcOccluded1M(scene, context, ray, M, byteStride); });
}

void rtcIntersect1Mp(RTCScene scene, RTCIntersectContext* context, RTCRayHit** rayhit, unsigned int M) {
  timed(scene, closest_hit, M, [=] { real().rtcIntersect1Mp(scene, context, rayhit, M); });
}

void rtcOccluded1Mp(RTCScene scene, RTCIntersectContext* context, RTCRay** ray, unsigned int M) {
  timed(scene, occlusion, M, [=] { real().rtcOccluded1Mp(scene, context, ray, M); });
}

void rtcIntersectNM(RTCScene scene, RTCIntersectContext* context, RTCRayHitN* rayhit, unsigned int N, unsigned int M,
                    size_t byteStride) {
  timed(scene, closest_hit, std::uint64_t{N} * M, [=] { real().rtcIntersectNM(scene, context, rayhit, N, M, byteStride); });
}

void rtcOccludedNM(RTCScene scene, RTCIntersectContext* context, RTCRayN* ray, unsigned int N, unsigned int M,
                   size_t byteStride) {
  timed(scene, occlusion, std::uint64_t{N} * M, [=] { real().rtcOccludedNM(scene, context, ray, N, M, byteStride); });
}

void rtcIntersectNp(RTCScene scene, RTCIntersectContext* context, const RTCRayHitNp* rayhit, unsigned int N) {
  timed(scene, closest_hit, N, [=] { real().rtcIntersectNp(scene, context, rayhit, N); });
}

void rtcOccludedNp(RTCScene scene, RTCIntersectContext* context, const RTCRayNp* ray, unsigned int N) {
  timed(scene, occlusion, N, [=] { real().rtcOccludedNp(scene, context, ray, N); });
}
