// The shim through its C ABI, for tools/sanitizers: scenes of every kind, their trees, errors, and a recorder with 8 threads. It
// checks what comes back against numbers that follow from the scene by hand, so that what the sanitizers see is the work itself.
//
//   shim QUERIES         all of it, with so many queries a thread
//   shim defect KIND     misuses the shim so that a sanitizer must stop it: address, undefined, race
#include "shim.h"

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "check.hpp"

namespace {

constexpr unsigned thread_count = 8;
constexpr float infinity = std::numeric_limits<float>::infinity();
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

using checks::Random;

// Triangles in the square [0,1] x [0,1] at z = 0, quads in [1,2] x [0,1] at z = -1: seen from above, a hit is known by where
// the query starts. Then a part without faces, and one whose only face Embree drops.
struct Plan {
  static constexpr std::uint32_t side = 24;
  static constexpr std::uint64_t triangles = 2 * side * side + 2 * side * side + 1;
  std::vector<float> vertices;
  std::vector<std::uint32_t> faces, quads, dropped;
  std::vector<ShimPart> parts;

  explicit Plan(float height = 0) {
    for (const float z : {0.0f, -1.0f}) {
      for (std::uint32_t y = 0; y <= side; y++) {
        for (std::uint32_t x = 0; x <= side; x++) {
          vertices.insert(vertices.end(), {float(x) / side - z, float(y) / side, z + height});
        }
      }
    }
    const auto corner = [](std::uint32_t x, std::uint32_t y) { return y * (side + 1) + x; };
    constexpr std::uint32_t behind = (side + 1) * (side + 1);
    for (std::uint32_t y = 0; y < side; y++) {
      for (std::uint32_t x = 0; x < side; x++) {
        const std::uint32_t a = corner(x, y), b = corner(x + 1, y), c = corner(x + 1, y + 1), d = corner(x, y + 1);
        faces.insert(faces.end(), {a, b, c, a, c, d});
        quads.insert(quads.end(), {a + behind, b + behind, c + behind, d + behind});
      }
    }
    const auto last = static_cast<std::uint32_t>(vertices.size() / 3);
    vertices.insert(vertices.end(), {nan, 0, 0});
    dropped = {0, 1, last};
    const auto flat = static_cast<std::uint32_t>(faces.size() / 3);
    const auto both = flat + static_cast<std::uint32_t>(quads.size() / 2);
    parts = {{faces.data(), faces.size() / 3, 3, 0xFFFFFFFFu, 0},
             {quads.data(), quads.size() / 4, 4, 2, flat},
             {nullptr, 0, 3, 0xFFFFFFFFu, both},
             {dropped.data(), 1, 3, 0xFFFFFFFFu, both}};
  }
  Plan(const Plan&) = delete;

  std::uint64_t vertex_count() const { return vertices.size() / 3; }

  ShimScene* scene(const ShimSettings& settings) const {
    ShimError error{};
    ShimScene* scene = shim_scene_new(&settings, vertices.data(), vertex_count(), parts.data(),
                                      static_cast<std::uint32_t>(parts.size()), &error);
    if (scene == nullptr) std::fprintf(stderr, "%s\n", error.message);
    CHECK(scene != nullptr);
    return scene;
  }
};

// Where a query from above, straight down, ends: infinity is a miss.
float expected_t(const float origin[3], float tfar, std::uint32_t mask) {
  const float x = origin[0], y = origin[1];
  if (!(y > 0 && y < 1)) return infinity;
  float t = infinity;
  if (x > 0 && x < 1 && mask != 0) t = origin[2];
  if (x > 1 && x < 2 && (mask & 2) != 0) t = origin[2] + 1;
  return t <= tfar ? t : infinity;
}

ShimQuery random_query(Random& random) {
  ShimQuery query{};
  query.origin[0] = 4 * random.unit() - 1;
  query.origin[1] = 1.5f * random.unit() - 0.25f;
  query.origin[2] = 1;
  query.direction[2] = -1;
  query.tfar = random.bits() % 4 == 0 ? 1.5f : infinity;
  query.mask = random.bits() % 8 == 0 ? 4 : 0xFFFFFFFFu;
  query.coherent = random.bits() % 2;
  query.purpose = 1;
  // Refused: each of these would abort Embree.
  if (random.bits() % 97 == 0) query.direction[random.bits() % 3] = nan;
  return query;
}

bool is_refused(const ShimQuery& query) {
  return std::isnan(query.direction[0]) || std::isnan(query.direction[1]) || std::isnan(query.direction[2]);
}

// Embree's own arithmetic may be off by some ulps.
bool is_near(float a, float b) { return a == b || std::fabs(a - b) < 1e-5f; }

// Every triangle that is kept stands in the tree, once unless it was split.
void check_tree(ShimTree* tree) {
  CHECK(tree != nullptr && tree->node_count > 0 && std::strncmp(tree->producer, "embree", 6) == 0);
  std::vector<std::uint32_t> times(Plan::triangles);
  for (std::uint64_t index = 0; index < tree->primitive_count; index++) {
    CHECK(tree->primitives[index] < Plan::triangles);
    times[tree->primitives[index]]++;
  }
  for (std::uint64_t triangle = 0; triangle + 1 < Plan::triangles; triangle++) {
    CHECK(times[triangle] == 1 || (tree->splits != 0 && times[triangle] > 1));
  }
  CHECK(times.back() == 0);
  std::uint64_t inner = 0;
  for (std::uint64_t node = 0; node < tree->node_count; node++) {
    const ShimNode& here = tree->nodes[node];
    const bool leaf = (here.count & 0x80000000u) != 0;
    const std::uint64_t end = std::uint64_t{here.first} + (here.count & 0x7FFFFFFFu);
    CHECK(end <= (leaf ? tree->primitive_count : tree->node_count) && (leaf || here.first > node));
    inner += leaf ? 0 : 1;
  }
  CHECK(inner > 0);
  shim_tree_free(tree);
}

void check_scene(const ShimScene* scene, float height) {
  float bounds[6];
  shim_scene_bounds(scene, bounds);
  CHECK(bounds[0] == 0 && bounds[1] == 0 && bounds[2] == height - 1 && bounds[3] == 2 && bounds[4] == 1 && bounds[5] == height);
  CHECK(shim_scene_triangle_count(scene) == Plan::triangles);
  std::vector<float> triangles(9 * Plan::triangles);
  CHECK(shim_scene_triangles(scene, triangles.data()) == 0);
  CHECK(triangles[2] == height && std::isnan(triangles[9 * Plan::triangles - 3]));
  ShimError error{};
  ShimTree* live = shim_tree_live(scene, nullptr, &error);
  if (live == nullptr) std::fprintf(stderr, "%s\n", error.message);
  check_tree(live);
  check_tree(shim_tree_built(scene, &error));
}

// Scenes of every kind, and what is done with them.
void scenes(const char* device) {
  for (const std::uint32_t quality : {SHIM_QUALITY_LOW, SHIM_QUALITY_MEDIUM, SHIM_QUALITY_HIGH}) {
    for (const std::uint32_t flags : {0, int(SHIM_SCENE_ROBUST), int(SHIM_SCENE_COMPACT)}) {
      for (const std::uint32_t commit : {SHIM_COMMIT_ONCE, SHIM_COMMIT_REFIT, SHIM_COMMIT_REBUILD}) {
        const Plan plan, higher(0.5f);
        ShimScene* scene = plan.scene({device, quality, flags, commit});
        check_scene(scene, 0);
        ShimError error{};
        const auto failed = shim_scene_update(scene, higher.vertices.data(), higher.vertex_count(), &error);
        CHECK((failed != 0) == (commit == SHIM_COMMIT_ONCE) && (failed == 0 || error.message[0] != '\0'));
        if (failed == 0) {
          CHECK(shim_scene_update(scene, plan.vertices.data(), 3, &error) != 0);
          check_scene(scene, 0.5f);
        }
        shim_scene_free(scene);
      }
    }
  }
}

// Every way to an error: each is one line, and none crashes.
void errors() {
  const Plan plan;
  ShimError error{};
  const ShimSettings wrong{"isa=none-such,threads=x,tri_accel=none-such", 1, 0, 0};
  ShimScene* none = shim_scene_new(&wrong, plan.vertices.data(), plan.vertex_count(), plan.parts.data(), 2, &error);
  CHECK(none == nullptr && error.message[0] != '\0' && std::strchr(error.message, '\n') == nullptr);

  const ShimSettings empty{"threads=1", 1, 0, 0};
  ShimScene* nothing = shim_scene_new(&empty, nullptr, 0, nullptr, 0, &error);
  CHECK(nothing != nullptr);
  float bounds[6];
  shim_scene_bounds(nothing, bounds);
  CHECK(bounds[0] == infinity && bounds[3] == -infinity);
  shim_tree_free(shim_tree_live(nothing, nullptr, &error));
  shim_tree_free(shim_tree_built(nothing, &error));
  shim_scene_free(nothing);

#ifndef __SANITIZE_THREAD__
  // A wrong pointer may lead to what another thread uses or has freed, so ThreadSanitizer does without these. The checks of the live tree, each seeing wrong bytes in turn: a tree or a doubt, never a read out of bounds.
  ShimScene* scene = plan.scene(empty);
  unsigned doubts = 0;
  for (std::uint32_t object = SHIM_OBJECT_SCENE; object <= SHIM_OBJECT_LEAF; object++) {
    for (std::uint64_t nth = 0; nth < 3; nth++) {
      for (std::uint32_t offset = 0; offset < 256; offset += 4) {
        for (const unsigned char flip : {0x01, 0x10, 0xFF}) {
          ShimFault fault{};
          fault.object = object;
          fault.nth = nth;
          fault.offset = offset;
          fault.length = flip == 0xFF ? 8 : 1;
          std::memset(fault.keep, 0xFF, sizeof fault.keep);
          std::memset(fault.flip, flip, sizeof fault.flip);
          ShimTree* tree = shim_tree_live(scene, &fault, &error);
          CHECK(tree != nullptr || error.code == SHIM_DOUBT);
          doubts += tree == nullptr ? 1 : 0;
          if (tree != nullptr) shim_tree_free(tree);
        }
      }
    }
  }
  CHECK(doubts > 300);
  shim_scene_free(scene);
#endif
}

// What one thread's sink has seen, and where all of them put it.
struct Recorded {
  std::mutex lock;
  std::uint64_t records = 0;
  std::uint64_t hits = 0;
  std::vector<ShimRecord> last;  // batch
};

struct Sink {
  Recorded* all;
  std::uint32_t next = 0;  // the path of the next record
  std::uint64_t batches = 0;
  std::uint64_t most = ~std::uint64_t{0};  // batches, before the recording is cut off
};

uint32_t take(void* user, const ShimRecord* records, uint64_t count) {
  Sink& sink = *static_cast<Sink*>(user);
  CHECK(count > 0 && count <= SHIM_BATCH_RECORDS && sink.batches < sink.most);
  std::uint64_t hits = 0;
  for (std::uint64_t index = 0; index < count; index++) {
    const ShimRecord& record = records[index];
    CHECK(record.path == sink.next++ && record.purpose == 1);
    const float t = expected_t(record.origin, record.tfar, record.mask);
    const bool hit = (record.flags & 1) != 0;
    CHECK(hit == (t != infinity));
    if (record.kind == 0) CHECK(is_near(record.t, t) && (record.triangle < Plan::triangles) == hit);
    hits += hit ? 1 : 0;
  }
  sink.batches++;
  const std::lock_guard<std::mutex> lock(sink.all->lock);
  sink.all->records += count;
  sink.all->hits += hits;
  sink.all->last.assign(records, records + count);
  return sink.batches == sink.most ? 1 : 0;
}

// Asks `count` queries in every form; returns how many were answered.
std::uint64_t ask(ShimIntersector* intersector, std::uint64_t count, std::uint64_t seed) {
  Random random(seed);
  std::uint64_t asked = 0, answered = 0;
  while (asked < count) {
    constexpr std::uint32_t widths[4] = {1, 4, 8, 16};
    const std::uint32_t width = widths[random.bits() % 4];
    const bool closest = random.bits() % 2 == 0;
    // As long as the packet is wide, and on the heap: a lane too many is an overflow.
    std::unique_ptr<ShimQuery[]> queries(new ShimQuery[width]);
    std::unique_ptr<ShimHit[]> hits(new ShimHit[width]);
    std::unique_ptr<std::uint32_t[]> outcomes(new std::uint32_t[width]);
    for (std::uint32_t lane = 0; lane < width; lane++) {
      queries[lane] = random_query(random);
      if (!is_refused(queries[lane])) queries[lane].path = static_cast<std::uint32_t>(answered++);
    }
    if (width == 1) {
      outcomes[0] = closest ? shim_closest_hit(intersector, &queries[0], &hits[0]) : shim_occluded(intersector, &queries[0]);
    } else if (closest) {
      shim_closest_hits(intersector, queries.get(), width, hits.get(), outcomes.get());
    } else {
      shim_occluded_packet(intersector, queries.get(), width, outcomes.get());
    }
    for (std::uint32_t lane = 0; lane < width; lane++) {
      const ShimQuery& query = queries[lane];
      const float t = expected_t(query.origin, query.tfar, query.mask);
      const std::uint32_t expected = is_refused(query) ? SHIM_REFUSED : t == infinity ? SHIM_MISS : SHIM_HIT;
      CHECK(outcomes[lane] == expected);
      if (closest && expected == SHIM_HIT) {
        CHECK(is_near(hits[lane].t, t) && hits[lane].part == (query.origin[0] > 1 ? 1u : 0u));
      }
    }
    asked += width;
  }
  CHECK(shim_refused(intersector) == asked - answered && asked > answered);
  return answered;
}

// 8 threads record one scene, while its tree is written and other scenes come and go; one thread's recording is cut off.
void record(const char* device, std::uint64_t queries) {
  const Plan plan;
  ShimScene* scene = plan.scene({device, SHIM_QUALITY_MEDIUM, 0, SHIM_COMMIT_ONCE});
  Recorded all;
  std::atomic<std::uint64_t> answered{0};
  std::atomic<bool> ended{false};
  constexpr std::uint64_t kept_batches = 3;
  std::vector<std::thread> threads;
  for (unsigned number = 0; number < thread_count; number++) {
    threads.emplace_back([&, number] {
      Sink sink{&all};
      const bool cut_off = number == thread_count - 1;
      if (cut_off) sink.most = kept_batches;
      ShimError error{};
      ShimIntersector* recording = shim_recording_new(shim_intersector_new(scene, &error), {&take, &sink}, &error);
      CHECK(recording != nullptr);
      const std::uint64_t mine = ask(recording, queries, number + 1);
      CHECK(shim_flush(recording) == (cut_off ? 1u : 0u));
      answered += cut_off ? kept_batches * SHIM_BATCH_RECORDS : mine;
      shim_intersector_free(recording);
      CHECK(!cut_off || sink.batches == kept_batches);
    });
  }
  // Trees are emitted and scenes made meanwhile.
  std::thread emitter([&] {
    do {
      ShimError error{};
      check_tree(shim_tree_live(scene, nullptr, &error));
      const Plan other(2);
      ShimScene* another = other.scene({device, SHIM_QUALITY_MEDIUM, SHIM_SCENE_ROBUST, SHIM_COMMIT_ONCE});
      check_scene(another, 2);
      shim_scene_free(another);
    } while (!ended.load());
  });
  for (std::thread& thread : threads) thread.join();
  ended = true;
  emitter.join();
  CHECK(all.records == answered && all.hits > 0 && all.hits < all.records && !all.last.empty());
  std::printf("%llu queries recorded by %u threads\n", static_cast<unsigned long long>(all.records), thread_count);
  shim_scene_free(scene);
}

// What must not be done with the shim. Each is a defect in the shim's own code, as a sanitizer sees it; when it returns, the sanitizer
// has not seen it.
void defect(const char* device, const std::string& kind) {
  const Plan plan;
  ShimScene* scene = plan.scene({device, SHIM_QUALITY_MEDIUM, 0, SHIM_COMMIT_ONCE});
  Recorded all;
  Sink sink{&all};
  ShimError error{};
  ShimIntersector* recording = shim_recording_new(shim_intersector_new(scene, &error), {&take, &sink}, &error);
  Random random(1);
  ShimQuery query = random_query(random);
  query.origin[0] = query.origin[1] = 0.3f;
  if (kind == "address") {
    // Room for the hits of half the packet.
    std::vector<ShimQuery> queries(16, query);
    std::vector<ShimHit> hits(8);
    std::uint32_t outcomes[16];
    hits.shrink_to_fit();
    shim_closest_hits(recording, queries.data(), 16, hits.data(), outcomes);
  } else if (kind == "undefined") {
    // A query at an odd address.
    std::vector<char> bytes(sizeof query + 1);
    std::memcpy(bytes.data() + 1, &query, sizeof query);
    shim_occluded(recording, reinterpret_cast<const ShimQuery*>(bytes.data() + 1));
  } else {
    // Two threads with one intersector. Their paths repeat, so nothing is looked at.
    const auto use = [&] {
      for (int number = 0; number < 100; number++) shim_occluded(recording, &query);
    };
    std::thread other(use);
    use();
    other.join();
  }
}

}  // namespace

int main(int count, char** words) {
#ifdef __SANITIZE_THREAD__
  // Callbacks of rtcBuildBVH run in TBB's threads, and ThreadSanitizer does not see what orders those: Embree is given no thread but the
  // one that calls it.
  const char* device = "threads=1";
#else
  const char* device = "threads=2";
#endif
  if (count == 3 && std::strcmp(words[1], "defect") == 0) {
    defect(device, words[2]);
    return 0;
  }
  const std::uint64_t queries = count == 2 ? std::strtoull(words[1], nullptr, 10) : 0;
  if (queries == 0) {
    std::fprintf(stderr, "shim: error: the number of queries of each thread is missing\n");
    return 2;
  }
  CHECK(shim_version() != 0);
  scenes(device);
  errors();
  record(device, queries);
  return 0;
}
