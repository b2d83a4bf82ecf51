// A program that uses Embree in every way that the preload library decorates, for tests/preload.rs: it prints what Embree
// answered, one line per query, and knows nothing of being recorded.
#include <embree3/rtcore.h>
#include <fcntl.h>
#include <signal.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

namespace {

RTCDevice device;

struct Vertex {
  float unused;
  float position[3];
};

// A grid of n x n squares in the plane z, each of two triangles or one quad, in memory of the caller's.
struct Grid {
  std::vector<Vertex> vertices;
  std::vector<std::uint32_t> indices;

  Grid(int n, float z, bool quads) {
    for (int y = 0; y <= n; y++) {
      for (int x = 0; x <= n; x++) vertices.push_back({-1, {float(x) / n, float(y) / n, z + 0.1f * float((x * y) % 3)}});
    }
    for (unsigned y = 0; y < unsigned(n); y++) {
      for (unsigned x = 0; x < unsigned(n); x++) {
        const unsigned a = y * (n + 1) + x, b = a + 1, c = b + n + 1, d = a + n + 1;
        if (quads) {
          indices.insert(indices.end(), {a, b, c, d});
        } else {
          // With a number in front of each triangle: indices have a stride, too.
          indices.insert(indices.end(), {7, a, b, c, 7, a, c, d});
        }
      }
    }
    // Embree reads 16 bytes from a vertex on.
    vertices.push_back({});
  }
};

RTCGeometry triangles(const Grid& grid) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, grid.vertices.data(), 4, sizeof(Vertex),
                             grid.vertices.size() - 1);
#ifdef EMBREE_4
  rtcSetSharedGeometryBufferHostDevice(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, grid.indices.data(),
                                       grid.indices.data(), 4, 16, grid.indices.size() / 4);
#else
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, grid.indices.data(), 4, 16,
                             grid.indices.size() / 4);
#endif
  rtcCommitGeometry(geometry);
  return geometry;
}

RTCGeometry quads(const Grid& grid) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_QUAD);
  const std::size_t count = grid.vertices.size() - 1;
  auto* vertices = static_cast<float*>(
      rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), count));
  for (std::size_t vertex = 0; vertex < count; vertex++) std::memcpy(vertices + 3 * vertex, grid.vertices[vertex].position, 12);
  // A buffer of its own, with something in front.
  RTCBuffer buffer = rtcNewBuffer(device, 16 + 4 * grid.indices.size());
  std::memcpy(static_cast<char*>(rtcGetBufferData(buffer)) + 16, grid.indices.data(), 4 * grid.indices.size());
  rtcSetGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT4, buffer, 16, 16, grid.indices.size() / 4);
  rtcReleaseBuffer(buffer);
  rtcCommitGeometry(geometry);
  return geometry;
}

// Instances an x-turned, scaled and moved scene.
RTCGeometry instance(RTCScene scene, float x, float scale) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(geometry, scene);
  const float transform[12] = {scale, 0.1f, 0, x, 0, 0.8f * scale, -0.6f * scale, 0.2f, 0, 0.6f * scale, 0.8f * scale, 0.5f};
  rtcSetGeometryTransform(geometry, 0, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, transform);
  rtcCommitGeometry(geometry);
  return geometry;
}

// Triangles that go from one grid to another, in three steps of time.
RTCGeometry moving_triangles(const Grid& first, const Grid& last) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  rtcSetGeometryTimeStepCount(geometry, 3);
  // The last one first: a slot is not a turn.
  for (const unsigned step : {2u, 0u, 1u}) {
    const Grid& grid = step == 0 ? first : last;
    rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, step, RTC_FORMAT_FLOAT3, grid.vertices.data(), 4,
                               sizeof(Vertex), grid.vertices.size() - 1);
  }
  rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, first.indices.data(), 4, 16,
                             first.indices.size() / 4);
  rtcCommitGeometry(geometry);
  return geometry;
}

RTCGeometry moving_instance(RTCScene scene, float x, float last_x) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(geometry, scene);
  rtcSetGeometryTimeStepCount(geometry, 2);
  for (unsigned step = 0; step < 2; step++) {
    const float transform[12] = {0.5f, 0, 0.1f, step == 0 ? x : last_x, 0, 0.5f, 0, 0.3f, 0.1f * step, 0, 0.5f, 1.2f};
    rtcSetGeometryTransform(geometry, step, RTC_FORMAT_FLOAT3X4_ROW_MAJOR, transform);
  }
  rtcCommitGeometry(geometry);
  return geometry;
}

void attach(RTCScene scene, RTCGeometry geometry, unsigned id) {
  rtcAttachGeometryByID(scene, geometry, id);
  rtcReleaseGeometry(geometry);
}

// Rejects primitives whose number divides by three.
void reject_thirds(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (arguments->valid[lane] == -1 && RTCHitN_primID(arguments->hit, arguments->N, lane) % 3 == 0) arguments->valid[lane] = 0;
  }
}

void reject_fourths(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (arguments->valid[lane] == -1 && RTCHitN_primID(arguments->hit, arguments->N, lane) % 4 == 0) arguments->valid[lane] = 0;
  }
}

// Accepts, and ends the ray: at once, nearer, or by what is no number. One in four is left as it
// is.
void end_rays(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (arguments->valid[lane] != -1) continue;
    float& tfar = RTCRayN_tfar(arguments->ray, arguments->N, lane);
    // Debian's Embree aborts when it goes on to another tree with NaN, and that of the quads is its
    // last.
    const bool last = RTCHitN_geomID(arguments->hit, arguments->N, lane) == 5;
    const float ends[] = {-INFINITY, 0.5f * tfar, last ? NAN : 0.25f * tfar, tfar};
    tfar = ends[RTCHitN_primID(arguments->hit, arguments->N, lane) % 4];
  }
}

// Accepts, and makes another hit of it.
void change_hits(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (arguments->valid[lane] == -1) RTCHitN_primID(arguments->hit, arguments->N, lane) += 1000000;
  }
}

// A sphere around everything, which is hit at infinity, and something that ends every third ray.
void bounds_of_sky(const RTCBoundsFunctionArguments* arguments) {
  *arguments->bounds_o = {-100, -100, -100, 0, 100, 100, 100, 0};
}

void hit_sky(const RTCIntersectFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (arguments->valid[lane] != -1) continue;
    auto* ray = RTCRayHitN_RayN(arguments->rayhit, arguments->N);
    float& tfar = RTCRayN_tfar(ray, arguments->N, lane);
    // Infinitely far away, unless something else was hit.
    if (tfar != INFINITY) continue;
    RTCHitN_geomID(RTCRayHitN_HitN(arguments->rayhit, arguments->N), arguments->N, lane) = arguments->geomID;
    RTCHitN_primID(RTCRayHitN_HitN(arguments->rayhit, arguments->N), arguments->N, lane) = 0;
    if (RTCRayN_dir_x(ray, arguments->N, lane) > 0) tfar = -INFINITY;
  }
}

float random_number() {
  static std::uint32_t state = 1;
  state = state * 1664525u + 1013904223u;
  return float(state >> 8) / float(1 << 24);
}

RTCRayHit random_ray(bool origin_low) {
  RTCRayHit ray{};
  ray.ray.org_x = random_number() * 3 - 1;
  ray.ray.org_y = random_number();
  ray.ray.org_z = origin_low ? -1 : 3;
  ray.ray.dir_x = random_number() - 0.5f;
  ray.ray.dir_y = random_number() - 0.5f;
  ray.ray.dir_z = origin_low ? 1 : -1;
  ray.ray.tfar = random_number() < 0.5f ? INFINITY : 3 * random_number();
  ray.ray.mask = random_number() < 0.5f ? 0xFFFFFFFFu : 6u;
  ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
  ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
  return ray;
}

void print(float t, unsigned geometry, unsigned primitive, unsigned instance) {
  std::uint32_t bits;
  std::memcpy(&bits, &t, sizeof bits);
  std::printf("%08x %d %d %d\n", bits, int(geometry), int(geometry == RTC_INVALID_GEOMETRY_ID ? -1 : primitive), int(instance));
}

void print(const RTCRayHit& ray) {
  const bool hit = ray.hit.geomID != RTC_INVALID_GEOMETRY_ID;
  print(hit ? ray.ray.tfar : INFINITY, ray.hit.geomID, ray.hit.primID, hit ? ray.hit.instID[0] : RTC_INVALID_GEOMETRY_ID);
}

void print(const RTCRay& ray) { print(ray.tfar == -INFINITY ? -INFINITY : INFINITY, -1, -1, -1); }

template <unsigned width, typename Packet, typename Ask, typename AskOccluded>
void packets(RTCScene scene, RTCIntersectContext* context, std::vector<RTCRayHit> rays, Ask ask, AskOccluded ask_occluded) {
  for (std::size_t first = 0; first + width <= rays.size(); first += width) {
    alignas(64) int valid[width];
    Packet packet, occluded;
    auto* words = reinterpret_cast<std::uint32_t*>(&packet);
    for (unsigned lane = 0; lane < width; lane++) {
      // Each eleventh lane is switched off.
      valid[lane] = (first + lane) % 11 == 10 ? 0 : -1;
      for (unsigned field = 0; field < 20; field++) {
        std::memcpy(&words[field * width + lane], reinterpret_cast<const char*>(&rays[first + lane]) + 4 * field, 4);
      }
    }
    occluded = packet;
    ask(valid, scene, context, &packet);
    ask_occluded(valid, scene, context, &occluded.ray);
    for (unsigned lane = 0; lane < width; lane++) {
      if (valid[lane] != 0) {
        print(packet.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID ? INFINITY : packet.ray.tfar[lane], packet.hit.geomID[lane],
              packet.hit.primID[lane], packet.hit.geomID[lane] == RTC_INVALID_GEOMETRY_ID ? -1u : packet.hit.instID[0][lane]);
      }
    }
    for (unsigned lane = 0; lane < width; lane++) {
      if (valid[lane] != 0) print(occluded.ray.tfar[lane] == -INFINITY ? -INFINITY : INFINITY, -1, -1, -1);
    }
  }
}

void single(RTCScene scene, RTCIntersectContext* context, const std::vector<RTCRayHit>& rays) {
  for (RTCRayHit ray : rays) {
    RTCRay occluded = ray.ray;
    rtcIntersect1(scene, context, &ray);
    print(ray);
    rtcOccluded1(scene, context, &occluded);
    print(occluded);
  }
}

#ifdef EMBREE_4
// Embree 4 has no streams, and asks traversables as it does scenes.
void traversable(RTCScene scene, RTCIntersectContext* context, const std::vector<RTCRayHit>& rays) {
  const RTCScene traversable = rtcGetSceneTraversable(scene);
  for (RTCRayHit ray : rays) {
    RTCRay occluded = ray.ray;
    four::traversable_intersect_1(traversable, context, &ray);
    print(ray);
    four::traversable_occluded_1(traversable, context, &occluded);
    print(occluded);
  }
  packets<4, RTCRayHit4>(traversable, context, rays, four::traversable_intersect_4, four::traversable_occluded_4);
}
#else
void streams(RTCScene scene, RTCIntersectContext* context, const std::vector<RTCRayHit>& rays) {
  const auto count = unsigned(rays.size());
  {
    std::vector<RTCRayHit> asked = rays;
    rtcIntersect1M(scene, context, asked.data(), count, sizeof(RTCRayHit));
    for (const RTCRayHit& ray : asked) print(ray);
    asked = rays;
    rtcOccluded1M(scene, context, &asked[0].ray, count, sizeof(RTCRayHit));
    for (const RTCRayHit& ray : asked) print(ray.ray);
  }
  {
    std::vector<RTCRayHit> asked = rays;
    std::vector<RTCRayHit*> pointers;
    std::vector<RTCRay*> occluded_pointers;
    for (RTCRayHit& ray : asked) pointers.push_back(&ray), occluded_pointers.push_back(&ray.ray);
    rtcIntersect1Mp(scene, context, pointers.data(), count);
    for (const RTCRayHit& ray : asked) print(ray);
    asked = rays;
    rtcOccluded1Mp(scene, context, occluded_pointers.data(), count);
    for (const RTCRayHit& ray : asked) print(ray.ray);
  }
  const auto word = [&](std::size_t ray, unsigned field) {
    float word;
    std::memcpy(&word, reinterpret_cast<const char*>(&rays[ray]) + 4 * field, 4);
    return word;
  };
  {
    // Packets of four, one behind the other.
    std::vector<RTCRayHit4> asked(count / 4);
    for (std::size_t ray = 0; ray < asked.size() * 4; ray++) {
      for (unsigned field = 0; field < 20; field++) {
        reinterpret_cast<float*>(&asked[ray / 4])[field * 4 + ray % 4] = word(ray, field);
      }
    }
    auto occluded = asked;
    rtcIntersectNM(scene, context, reinterpret_cast<RTCRayHitN*>(asked.data()), 4, unsigned(asked.size()), sizeof(RTCRayHit4));
    for (const RTCRayHit4& packet : asked) {
      for (int lane = 0; lane < 4; lane++) {
        const bool hit = packet.hit.geomID[lane] != RTC_INVALID_GEOMETRY_ID;
        print(hit ? packet.ray.tfar[lane] : INFINITY, packet.hit.geomID[lane], packet.hit.primID[lane],
              hit ? packet.hit.instID[0][lane] : -1u);
      }
    }
    rtcOccludedNM(scene, context, reinterpret_cast<RTCRayN*>(occluded.data()), 4, unsigned(occluded.size()), sizeof(RTCRayHit4));
    for (const RTCRayHit4& packet : occluded) {
      for (int lane = 0; lane < 4; lane++) print(packet.ray.tfar[lane] == -INFINITY ? -INFINITY : INFINITY, -1, -1, -1);
    }
  }
  {
    std::vector<std::vector<float>> fields(20, std::vector<float>(count));
    for (std::size_t ray = 0; ray < count; ray++) {
      for (unsigned field = 0; field < 20; field++) fields[field][ray] = word(ray, field);
    }
    RTCRayHitNp pointers;
    for (unsigned field = 0; field < 20; field++) {
      float* start = fields[field].data();
      std::memcpy(reinterpret_cast<char*>(&pointers) + sizeof start * field, &start, sizeof start);
    }
    rtcIntersectNp(scene, context, &pointers, count);
    for (std::size_t ray = 0; ray < count; ray++) {
      const bool hit = pointers.hit.geomID[ray] != RTC_INVALID_GEOMETRY_ID;
      print(hit ? pointers.ray.tfar[ray] : INFINITY, pointers.hit.geomID[ray], pointers.hit.primID[ray],
            hit ? pointers.hit.instID[0][ray] : -1u);
    }
    for (std::size_t ray = 0; ray < count; ray++) fields[8][ray] = word(ray, 8);
    rtcOccludedNp(scene, context, &pointers.ray, count);
    for (std::size_t ray = 0; ray < count; ray++) print(fields[8][ray] == -INFINITY ? -INFINITY : INFINITY, -1, -1, -1);
  }
}

#endif

std::vector<RTCRayHit> random_rays(unsigned count) {
  std::vector<RTCRayHit> rays;
  for (unsigned ray = 0; ray < count; ray++) rays.push_back(random_ray(ray % 2 == 0));
  return rays;
}

// 8 threads, each with scenes of its own that it fills, commits, asks, changes and releases, beside one that all ask and one that all commit
// together: all that the recorder locks or counts, at once.
void busy(RTCScene shared, RTCScene child, RTCIntersectContext context, const std::vector<RTCRayHit>& rays) {
  std::atomic<unsigned> hits{0};
  const auto count_hits = [&](RTCScene scene, RTCIntersectContext* own) {
    for (RTCRayHit ray : rays) {
      rtcIntersect1(scene, own, &ray);
      hits += ray.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1 : 0;
    }
  };
  for (int round = 0; round < 6; round++) {
    RTCScene joined = rtcNewScene(device);
    const Grid together(9, 0.3f, false);
    attach(joined, triangles(together), 0);
    std::vector<std::thread> threads;
    for (int number = 0; number < 8; number++) {
      threads.emplace_back([&, number] {
        RTCIntersectContext own = context;
        const Grid grid(4 + number, 0.2f, false);
        rtcJoinCommitScene(joined);
        count_hits(joined, &own);
        RTCScene scene = rtcNewScene(device);
        RTCGeometry geometry = triangles(grid);
        rtcRetainGeometry(geometry);
        rtcSetGeometryIntersectFilterFunction(geometry, number % 2 == 0 ? reject_thirds : reject_fourths);
        rtcCommitGeometry(geometry);
        attach(scene, geometry, 1);
        attach(scene, instance(child, 0.1f * number, 0.6f), 4);
        rtcCommitScene(scene);
        count_hits(scene, &own);
        rtcDisableGeometry(geometry);
        rtcCommitGeometry(geometry);
        rtcCommitScene(scene);
        count_hits(scene, &own);
        rtcDetachGeometry(scene, 4);
        rtcReleaseGeometry(geometry);
        rtcReleaseScene(scene);
        count_hits(shared, &own);
      });
    }
    for (std::thread& thread : threads) thread.join();
    rtcReleaseScene(joined);
  }
  std::printf("%u hits\n", hits.load());
}

// A mesh that moves from frame to frame, and stands where it started in every other one: Embree refits its tree, or builds it
// anew. The commits in between change nothing.
void frames(RTCIntersectContext* context, RTCBuildQuality quality, int count) {
  Grid grid(8, 0.2f, false);
  RTCGeometry geometry = triangles(grid);
  rtcSetGeometryBuildQuality(geometry, quality);
  rtcCommitGeometry(geometry);
  RTCScene scene = rtcNewScene(device);
  rtcSetSceneFlags(scene, RTC_SCENE_FLAG_DYNAMIC);
  rtcSetSceneBuildQuality(scene, quality == RTC_BUILD_QUALITY_REFIT ? RTC_BUILD_QUALITY_LOW : quality);
  rtcAttachGeometryByID(scene, geometry, 2);
  const std::vector<Vertex> start = grid.vertices;
  for (int frame = 0; frame < count; frame++) {
    grid.vertices = start;
    for (Vertex& vertex : grid.vertices) vertex.position[2] += frame % 2 == 0 ? 0 : 0.1f * vertex.position[0] * float(frame);
    rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
    rtcCommitGeometry(geometry);
    rtcCommitScene(scene);
    single(scene, context, random_rays(100));
    rtcCommitScene(scene);
    single(scene, context, random_rays(100));
  }
  rtcReleaseGeometry(geometry);
  rtcReleaseScene(scene);
}

// The same scene on two devices, which two threads make, ask and release, at once.
void devices(RTCIntersectContext context, const std::vector<RTCRayHit>& rays) {
  std::atomic<unsigned> hits{0};
  std::vector<std::thread> threads;
  const Grid grid(13, 0, false);
  for (int number = 0; number < 2; number++) {
    threads.emplace_back([&] {
      RTCIntersectContext own = context;
      RTCDevice one = rtcNewDevice(nullptr);
      for (int round = 0; round < 20; round++) {
        RTCGeometry geometry = rtcNewGeometry(one, RTC_GEOMETRY_TYPE_TRIANGLE);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, grid.vertices.data(), 4,
                                   sizeof(Vertex), grid.vertices.size() - 1);
        rtcSetSharedGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, grid.indices.data(), 4, 16,
                                   grid.indices.size() / 4);
        rtcCommitGeometry(geometry);
        RTCScene scene = rtcNewScene(one);
        attach(scene, geometry, 3);
        rtcCommitScene(scene);
        for (RTCRayHit ray : rays) {
          rtcIntersect1(scene, &own, &ray);
          hits += ray.hit.geomID != RTC_INVALID_GEOMETRY_ID ? 1 + ray.hit.primID : 0;
        }
        rtcReleaseScene(scene);
      }
      rtcReleaseDevice(one);
    });
  }
  for (std::thread& thread : threads) thread.join();
  std::printf("%u\n", hits.load());
}

// 8 threads ask until the process is ended, and count in a file what was answered, each in a number of its own: what has been counted is in the
// file however the process ends. For tools/faults.
void count(RTCScene scene, RTCIntersectContext context, const std::vector<RTCRayHit>& rays, const char* path) {
  constexpr std::size_t bytes = 8 * sizeof(std::uint64_t);
  const int file = open(path, O_RDWR | O_CREAT, 0666);
  void* memory = file < 0 || ftruncate(file, bytes) != 0 ? MAP_FAILED : mmap(nullptr, bytes, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  if (memory == MAP_FAILED) std::exit(3);
  std::vector<std::thread> threads;
  for (int number = 0; number < 8; number++) {
    threads.emplace_back([&, answered = static_cast<std::uint64_t*>(memory) + number] {
      RTCIntersectContext own = context;
      for (;;) {
        for (std::size_t index = 0; index < rays.size(); index++) {
          RTCRayHit ray = rays[index];
          rtcIntersect1(scene, &own, &ray);
          __atomic_fetch_add(answered, 1, __ATOMIC_RELEASE);
          // Half a million queries a second, not more than a disk takes.
          if (index % 64 == 0) usleep(1000);
        }
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// Misuses Embree so that what the recorder does with it is a defect, which a sanitizer must see: then this does not end.
void defect(RTCScene scene, RTCIntersectContext* context, const std::string& kind) {
  if (kind == "defect-address") {
    // A query in memory that is freed.
    auto* asked = new RTCRayHit(random_ray(true));
    delete asked;
    rtcIntersect1(scene, context, asked);
  } else if (kind == "defect-undefined") {
    alignas(16) char bytes[5 * sizeof(int)] = {};
    RTCRayHit4 rays{};
    rtcIntersect4(reinterpret_cast<const int*>(bytes + 1), scene, context, &rays);
  } else {
    // One thread moves a vertex while the other commits: what the recorder writes down is then neither.
    Grid grid(3, 0, false);
    RTCScene own = rtcNewScene(device);
    attach(own, triangles(grid), 0);
    std::thread other([&] { grid.vertices[0].position[0] = 1; });
    rtcCommitScene(own);
    other.join();
    rtcReleaseScene(own);
  }
}

}  // namespace

int main(int, char** arguments) {
  const std::string what = arguments[1];
  device = rtcNewDevice(nullptr);
  const Grid floor(13, 0, false), wall(7, 0.7f, true), hidden(5, 0.4f, false), small(6, 0, false);
  const Grid low(5, 0.9f, false), high(5, 1.6f, false);

  RTCScene child = rtcNewScene(device);
  attach(child, triangles(small), 2);
  attach(child, quads(wall), 0);
  const bool moves = what.find("motion") == 0;
  if (moves) attach(child, moving_triangles(low, high), 4);
  rtcCommitScene(child);

  RTCScene masked = nullptr;
  RTCGeometry changing = nullptr;
  if (what == "masks") {
    // Geometries with masks of their own, one above the other.
    masked = rtcNewScene(device);
    for (unsigned number = 0; number < 4; number++) {
      RTCGeometry geometry = number % 2 == 0 ? triangles(small) : quads(wall);
      const unsigned masks[] = {2, 5, 0, 0xC};
      rtcSetGeometryMask(geometry, masks[number]);
      rtcCommitGeometry(geometry);
      if (number == 0) changing = geometry;
      attach(masked, geometry, number);
    }
    rtcCommitScene(masked);
  }

  RTCScene scene = rtcNewScene(device);
  if (what == "robust") rtcSetSceneFlags(scene, RTC_SCENE_FLAG_ROBUST);
  if (what == "context-filter" || what == "changed") rtcSetSceneFlags(scene, RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
  if (what == "splits") rtcSetSceneBuildQuality(scene, RTC_BUILD_QUALITY_HIGH);
  RTCGeometry ground = triangles(floor);
  rtcRetainGeometry(ground);
  attach(scene, ground, 3);
  RTCGeometry upper = quads(wall);
  rtcSetGeometryMask(upper, 0xA);
  if (what.find("filters") != std::string::npos) {
    rtcSetGeometryIntersectFilterFunction(ground, reject_thirds);
    rtcSetGeometryOccludedFilterFunction(ground, reject_thirds);
    rtcSetGeometryIntersectFilterFunction(upper, reject_fourths);
    rtcSetGeometryOccludedFilterFunction(upper, reject_fourths);
    rtcCommitGeometry(ground);
  }
  if (what == "ended" || what == "changed") {
    for (RTCGeometry geometry : {ground, upper}) {
      rtcSetGeometryIntersectFilterFunction(geometry, what == "ended" ? end_rays : change_hits);
    }
    rtcCommitGeometry(ground);
  }
  rtcCommitGeometry(upper);
  attach(scene, upper, 5);
  if (what == "sky") {
    RTCGeometry sky = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_USER);
    rtcSetGeometryUserPrimitiveCount(sky, 1);
    rtcSetGeometryBoundsFunction(sky, bounds_of_sky, nullptr);
    rtcSetGeometryIntersectFunction(sky, hit_sky);
    rtcSetGeometryOccludedFunction(sky, [](const RTCOccludedFunctionNArguments*) {});
    rtcCommitGeometry(sky);
    attach(scene, sky, 9);
  }
  RTCGeometry off = triangles(hidden);
  rtcDisableGeometry(off);
  attach(scene, off, 0);
  if (what == "instances") {
    attach(scene, instance(child, -0.9f, 0.8f), 8);
    attach(scene, instance(child, 1.1f, 0.7f), 6);
    attach(scene, instance(child, 0.3f, 0.4f), 7);
  }
  if (what == "masks") {
    for (unsigned number = 0; number < 16; number++) {
      RTCGeometry placed = instance(masked, 0.25f * number - 2, 0.3f);
      rtcSetGeometryMask(placed, number);
      rtcCommitGeometry(placed);
      attach(scene, placed, 20 + number);
    }
  }
  if (moves) {
    attach(scene, moving_triangles(low, high), 1);
    attach(scene, instance(child, -0.9f, 0.8f), 8);
    attach(scene, moving_instance(child, 0.8f, 1.5f), 6);
  }
  rtcCommitScene(scene);
  // It lives on in its instances.
  if (what != "busy") rtcReleaseScene(child);

  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  if (what == "coherent") context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  if (what == "coherent-filters") context.flags = RTC_INTERSECT_CONTEXT_FLAG_COHERENT;
  if (what == "context-filter" || what == "changed") context.filter = reject_thirds;

  auto rays = random_rays(4000);
  if (what == "motion") {
    for (RTCRayHit& ray : rays) ray.ray.time = random_number();
  }
  if (what == "packets") {
    packets<4, RTCRayHit4>(scene, &context, rays, rtcIntersect4, rtcOccluded4);
    packets<8, RTCRayHit8>(scene, &context, rays, rtcIntersect8, rtcOccluded8);
    packets<16, RTCRayHit16>(scene, &context, rays, rtcIntersect16, rtcOccluded16);
#ifdef EMBREE_4
  } else if (what == "traversable") {
    traversable(scene, &context, rays);
#else
  } else if (what == "streams" || what == "coherent" || what == "stream-filters" || what == "coherent-filters") {
    streams(scene, &context, rays);
#endif
  } else if (what == "masks") {
    for (int commit = 0; commit < 2; commit++) {
      for (std::size_t ray = 0; ray < rays.size(); ray++) {
        rays[ray].ray.org_x = random_number() * 6 - 3;
        rays[ray].ray.mask = unsigned(ray % 17 == 16 ? -1 : ray % 17);
      }
      single(scene, &context, rays);
      packets<8, RTCRayHit8>(scene, &context, rays, rtcIntersect8, rtcOccluded8);
      // Another mask, and all that hold it committed anew.
      rtcSetGeometryMask(changing, 9);
      rtcCommitGeometry(changing);
      rtcCommitScene(masked);
      for (unsigned number = 0; number < 16; number++) rtcCommitGeometry(rtcGetGeometry(scene, 20 + number));
      rtcCommitScene(scene);
    }
  } else if (what == "ended" || what == "changed") {
    single(scene, &context, rays);
    packets<4, RTCRayHit4>(scene, &context, rays, rtcIntersect4, rtcOccluded4);
    packets<8, RTCRayHit8>(scene, &context, rays, rtcIntersect8, rtcOccluded8);
  } else if (what == "filters" || what == "context-filter") {
    single(scene, &context, rays);
    packets<4, RTCRayHit4>(scene, &context, rays, rtcIntersect4, rtcOccluded4);
    packets<8, RTCRayHit8>(scene, &context, rays, rtcIntersect8, rtcOccluded8);
  } else if (what == "commits") {
    for (int round = 0; round < 3; round++) {
      single(scene, &context, random_rays(500));
      rtcCommitScene(scene);  // without a change
      single(scene, &context, random_rays(500));
      if (round == 0) rtcEnableGeometry(off);
      if (round == 1) rtcDetachGeometry(scene, 5);
      rtcCommitScene(scene);
    }
    rtcReleaseScene(scene);
    scene = rtcNewScene(device);
    attach(scene, triangles(small), 1);
    rtcCommitScene(scene);
    single(scene, &context, random_rays(500));
  } else if (what == "threads") {
    for (int round = 0; round < 40; round++) {
      std::vector<std::thread> threads;
      for (int number = 0; number < 8; number++) {
        threads.emplace_back([&] {
          RTCIntersectContext own = context;
          for (RTCRayHit ray : rays) rtcIntersect1(scene, &own, &ray);
        });
      }
      for (std::thread& thread : threads) thread.join();
    }
  } else if (what == "busy") {
    rays.resize(500);
    busy(scene, child, context, rays);
  } else if (what == "refits" || what == "rebuilds") {
    frames(&context, what == "refits" ? RTC_BUILD_QUALITY_REFIT : RTC_BUILD_QUALITY_MEDIUM, 10);
  } else if (what == "many-frames") {
    frames(&context, RTC_BUILD_QUALITY_MEDIUM, 40);
  } else if (what == "devices") {
    rays.resize(500);
    devices(context, rays);
  } else if (what == "count") {
    count(scene, context, rays, arguments[2]);
  } else if (what.find("defect-") == 0) {
    defect(scene, &context, what);
  } else if (what == "fork") {
    single(scene, &context, rays);
    std::fflush(stdout);
    const pid_t forked = fork();
    single(scene, &context, rays);
    std::fflush(stdout);
    if (forked == 0) _exit(0);
    waitpid(forked, nullptr, 0);
    _exit(7);
  } else if (what == "children") {
    // As many processes as it is told, one after the other or all at once, which all ask a part of
    // the rays, and end in every way.
    const int count = std::atoi(arguments[2]);
    const bool together = std::string(arguments[3]) == "together";
    std::vector<pid_t> children;
    int go[2], asked[2];
    if (pipe(go) != 0 || pipe(asked) != 0) return 3;
    rays.resize(20);
    for (int number = 0; number < count; number++) {
      const pid_t forked = fork();
      if (forked == 0) {
        single(scene, &context, rays);
        std::fflush(stdout);
        // Nobody ends before all have asked.
        char byte = 0;
        close(go[1]);
        if (together && (write(asked[1], &byte, 1) != 1 || read(go[0], &byte, 1) != 0)) _exit(4);
        if (number % 3 == 0) kill(getpid(), SIGKILL);
        if (number % 3 == 1) kill(getpid(), SIGTERM);
        _exit(0);
      }
      if (forked < 0) return 3;
      children.push_back(forked);
      if (!together) waitpid(forked, nullptr, 0);
    }
    char byte;
    for (int number = 0; together && number < count; number++) {
      if (read(asked[0], &byte, 1) != 1) return 3;
    }
    close(go[1]);
    for (const pid_t child : children) waitpid(child, nullptr, 0);
    _exit(0);
  } else if (what == "kill") {
    single(scene, &context, rays);
    std::fflush(stdout);
    kill(getpid(), SIGKILL);
  } else {
    single(scene, &context, rays);
  }
  if (what == "busy") rtcReleaseScene(child);
  if (masked != nullptr) rtcReleaseScene(masked);
  rtcReleaseGeometry(ground);
  rtcReleaseScene(scene);
  rtcReleaseDevice(device);
  return 0;
}
