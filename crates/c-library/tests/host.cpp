// A program that has nothing but Embree's API and embree_trace/plant.h, for tests/c_library.rs.
//
//   host record FLAGS CONFIG        asks in every way, records into casts.rays and built.bvh, and
//                                   writes what it asked and was answered into asked.bin
//   host plant FLAGS CONFIG TREE    plants, asks, gives back, in every order; prints what it planted
//   host files FLAGS CONFIG         plants every file that is named on its standard input; prints
//                                   what became of each
//   host states FLAGS CONFIG TREE   everything that is not possible
//
// Whatever is planted, the answers are those of Embree's own tree.
#include <embree3/rtcore.h>
#include <embree_trace/plant.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <iterator>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#define CHECK_SAID et_error_message()
#include "../../../tests/sanitizers/check.hpp"

namespace {

using checks::Random;

// What a query asked and was answered, as the program itself sees it.
struct Asked {
  float origin[3];
  float tnear;
  float direction[3];
  float tfar;
  float time;
  std::uint32_t mask;
  std::uint32_t occlusion;
  std::uint32_t hit;
  float t;
  std::uint32_t geometry;
  std::uint32_t primitive;
  std::uint32_t path;
};
static_assert(sizeof(Asked) == 64);

// Refuses a third of all candidates. The pointer behind the context leads to how often it was
// asked.
struct Context {
  RTCIntersectContext embree;
  unsigned filtered = 0;
};

void refuse_a_third(const RTCFilterFunctionNArguments* arguments) {
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (RTCHitN_primID(arguments->hit, arguments->N, lane) % 3 == 0) arguments->valid[lane] = 0;
  }
}

void refuse_another(const RTCFilterFunctionNArguments* arguments) {
  reinterpret_cast<Context*>(arguments->context)->filtered++;
  for (unsigned lane = 0; lane < arguments->N; lane++) {
    if (RTCHitN_primID(arguments->hit, arguments->N, lane) % 5 == 1) arguments->valid[lane] = 0;
  }
}

// A scene of triangles and quads with numbers, strides, masks and filters of its own.
class Program {
 public:
  Program(const char* config, int flags, unsigned faces, std::uint64_t seed)
      : device_(rtcNewDevice(config)), random_(seed) {
    if (device_ == nullptr) return;
    scene_ = rtcNewScene(device_);
    rtcSetSceneFlags(scene_, static_cast<RTCSceneFlags>(flags | RTC_SCENE_FLAG_DYNAMIC |
                                                        RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION));
    add(RTC_GEOMETRY_TYPE_TRIANGLE, 3, faces);
    add(RTC_GEOMETRY_TYPE_QUAD, 7, faces / 2);
    add(RTC_GEOMETRY_TYPE_TRIANGLE, 4, faces / 3);
    rtcSetGeometryIntersectFilterFunction(geometries_[2], refuse_a_third);
    rtcSetGeometryOccludedFilterFunction(geometries_[2], refuse_a_third);
    rtcCommitGeometry(geometries_[2]);
    rtcCommitScene(scene_);
    for (int ray = 0; ray < 400; ray++) rays_.push_back(any_ray());
  }
  ~Program() { release(); }
  Program(const Program&) = delete;
  Program& operator=(const Program&) = delete;

  bool is_there() const { return device_ != nullptr; }
  RTCScene scene() const { return scene_; }
  RTCDevice device() const { return device_; }
  const std::vector<RTCGeometry>& geometries() const { return geometries_; }

  void release() {
    for (RTCGeometry geometry : geometries_) rtcReleaseGeometry(geometry);
    geometries_.clear();
    if (scene_ != nullptr) rtcReleaseScene(scene_);
    if (device_ != nullptr) rtcReleaseDevice(device_);
    scene_ = nullptr;
    device_ = nullptr;
  }

  void change() {
    for (RTCGeometry geometry : geometries_) {
      rtcUpdateGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0);
      rtcCommitGeometry(geometry);
    }
  }

  // Distances, -1 for a miss. What is occluded is what is hit.
  std::vector<float> answers() const { return answers_of(scene_); }
  std::vector<float> answers_of(RTCScene scene) const {
    std::vector<float> found;
    for (std::size_t index = 0; index < rays_.size(); index++) {
      Context context;
      rtcInitIntersectContext(&context.embree);
      if (index % 2 == 0) context.embree.filter = refuse_another;
      RTCRayHit asked = rays_[index];
      rtcIntersect1(scene, &context.embree, &asked);
      const bool hit = asked.hit.geomID != RTC_INVALID_GEOMETRY_ID;
      RTCRay shadow = rays_[index].ray;
      rtcOccluded1(scene, &context.embree, &shadow);
      CHECK((shadow.tfar < 0) == hit);
      found.push_back(hit ? asked.ray.tfar : -1);
    }
    return found;
  }

  // One by one, in packets of each width with lanes that are off, and in streams; on one thread, in
  // order.
  std::vector<Asked> ask_in_every_way() {
    std::vector<Asked> all;
    Context context;
    rtcInitIntersectContext(&context.embree);
    for (std::uint32_t index = 0; index < rays_.size(); index++) {
      context.embree.filter = index % 3 == 0 ? refuse_another : nullptr;
      et_record_label(index, static_cast<std::uint8_t>(index % 4), ET_PURPOSE_DIFFUSE);
      RTCRayHit asked = rays_[index];
      rtcIntersect1(scene_, &context.embree, &asked);
      all.push_back(asked_of(rays_[index].ray, index, asked.hit.geomID != RTC_INVALID_GEOMETRY_ID,
                             asked.ray.tfar, &asked.hit));
      RTCRay shadow = rays_[index].ray;
      rtcOccluded1(scene_, &context.embree, &shadow);
      all.push_back(asked_of(rays_[index].ray, index, shadow.tfar < 0, 0, nullptr));
    }
    CHECK(context.filtered != 0);
    et_record_label(ET_NO_PATH, ET_NO_DEPTH, ET_PURPOSE_UNKNOWN);
    ask_packets<4, RTCRayHit4, RTCRay4>(all, rtcIntersect4, rtcOccluded4,
                                        RTC_DEVICE_PROPERTY_NATIVE_RAY4_SUPPORTED);
    ask_packets<8, RTCRayHit8, RTCRay8>(all, rtcIntersect8, rtcOccluded8,
                                        RTC_DEVICE_PROPERTY_NATIVE_RAY8_SUPPORTED);
    ask_packets<16, RTCRayHit16, RTCRay16>(all, rtcIntersect16, rtcOccluded16,
                                           RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED);
    context.embree.filter = refuse_another;
    for (const RTCIntersectContextFlags flags :
         {RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT, RTC_INTERSECT_CONTEXT_FLAG_COHERENT}) {
      context.embree.flags = flags;
      std::vector<RTCRayHit> stream = rays_;
      rtcIntersect1M(scene_, &context.embree, stream.data(), static_cast<unsigned>(stream.size()),
                     sizeof stream[0]);
      for (std::size_t index = 0; index < stream.size(); index++) {
        const bool hit = stream[index].hit.geomID != RTC_INVALID_GEOMETRY_ID;
        all.push_back(asked_of(rays_[index].ray, ET_NO_PATH, hit, stream[index].ray.tfar,
                               &stream[index].hit));
      }
    }
    return all;
  }

  // Streams that Embree puts into another order. Returns how many queries, and how many of them
  // hit.
  std::pair<std::uint64_t, std::uint64_t> ask_streams() {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    std::uint64_t asked = 0;
    std::uint64_t hits = 0;
    for (const RTCIntersectContextFlags flags :
         {RTC_INTERSECT_CONTEXT_FLAG_INCOHERENT, RTC_INTERSECT_CONTEXT_FLAG_COHERENT}) {
      context.flags = flags;
      for (unsigned count = 1; count <= rays_.size(); count += 57) {
        std::vector<RTCRay> stream;
        for (unsigned index = 0; index < count; index++) stream.push_back(rays_[index].ray);
        rtcOccluded1M(scene_, &context, stream.data(), count, sizeof stream[0]);
        asked += count;
        for (const RTCRay& ray : stream) hits += ray.tfar < 0 ? 1 : 0;
        std::vector<RTCRay*> pointers;
        for (unsigned index = 0; index < count; index++) {
          stream[index] = rays_[index].ray;
          pointers.push_back(&stream[index]);
        }
        rtcOccluded1Mp(scene_, &context, pointers.data(), count);
        asked += count;
        for (const RTCRay& ray : stream) hits += ray.tfar < 0 ? 1 : 0;
      }
    }
    return {asked, hits};
  }

 private:
  static Asked asked_of(const RTCRay& ray, std::uint32_t path, bool hit, float t,
                        const RTCHit* what) {
    Asked asked{{ray.org_x, ray.org_y, ray.org_z},
                ray.tnear,
                {ray.dir_x, ray.dir_y, ray.dir_z},
                ray.tfar,
                ray.time,
                ray.mask,
                what == nullptr ? 1u : 0u,
                hit ? 1u : 0u,
                t,
                0,
                0,
                path};
    if (what != nullptr && hit) {
      asked.geometry = what->geomID;
      asked.primitive = what->primID;
    }
    return asked;
  }

  template <unsigned width, typename Hits, typename Rays, typename Intersect, typename Occluded>
  void ask_packets(std::vector<Asked>& all, Intersect intersect, Occluded occluded,
                   RTCDeviceProperty native) {
    // Where it has no kernel of the width, Embree 3.13.5 asks lanes that are off, too.
    const bool some_off = rtcGetDeviceProperty(device_, native) != 0;
    for (std::size_t first = 0; first + width <= rays_.size(); first += width) {
      RTCIntersectContext context;
      rtcInitIntersectContext(&context);
      alignas(64) int valid[width];
      Hits hits{};
      Rays rays{};
      const auto put = [&](auto* packet, const auto& one, unsigned lane) {
        for (std::size_t field = 0; field < sizeof one / 4; field++) {
          std::memcpy(reinterpret_cast<float*>(packet) + field * width + lane,
                      reinterpret_cast<const float*>(&one) + field, 4);
        }
      };
      for (unsigned lane = 0; lane < width; lane++) {
        valid[lane] = some_off && (first + lane) % 5 == 0 ? 0 : -1;
        put(&hits, rays_[first + lane], lane);
        put(&rays, rays_[first + lane].ray, lane);
      }
      intersect(valid, scene_, &context, &hits);
      for (unsigned lane = 0; lane < width; lane++) {
        if (valid[lane] == 0) continue;
        RTCHit hit{};
        hit.geomID = hits.hit.geomID[lane];
        hit.primID = hits.hit.primID[lane];
        all.push_back(asked_of(rays_[first + lane].ray, ET_NO_PATH,
                               hit.geomID != RTC_INVALID_GEOMETRY_ID, hits.ray.tfar[lane], &hit));
      }
      occluded(valid, scene_, &context, &rays);
      for (unsigned lane = 0; lane < width; lane++) {
        if (valid[lane] == 0) continue;
        all.push_back(
            asked_of(rays_[first + lane].ray, ET_NO_PATH, rays.tfar[lane] < 0, 0, nullptr));
      }
    }
  }

  RTCRayHit any_ray() {
    RTCRayHit ray{};
    ray.ray.org_x = 2 * random_.signed_unit();
    ray.ray.org_y = 2 * random_.signed_unit();
    ray.ray.org_z = 2 * random_.signed_unit();
    ray.ray.dir_x = random_.signed_unit() - ray.ray.org_x;
    ray.ray.dir_y = random_.signed_unit() - ray.ray.org_y;
    ray.ray.dir_z = random_.signed_unit() - ray.ray.org_z;
    ray.ray.tfar = std::numeric_limits<float>::infinity();
    ray.ray.mask = 1 + static_cast<unsigned>(random_.bits() % 7);
    ray.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    ray.hit.instID[0] = RTC_INVALID_GEOMETRY_ID;
    return ray;
  }

  void add(RTCGeometryType type, unsigned id, unsigned faces) {
    const bool quads = type == RTC_GEOMETRY_TYPE_QUAD;
    const std::size_t corners = quads ? 4 : 3;
    RTCGeometry geometry = rtcNewGeometry(device_, type);
    const std::size_t stride = 12 + 4 * (id % 3);
    const std::size_t face_stride = 4 * corners + 4 * (id % 2);
    auto* vertices = static_cast<char*>(rtcSetNewGeometryBuffer(
        geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, stride, corners * faces));
    auto* indices = static_cast<char*>(
        rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0,
                                quads ? RTC_FORMAT_UINT4 : RTC_FORMAT_UINT3, face_stride, faces));
    for (unsigned face = 0; face < faces; face++) {
      float points[4][3];
      for (int axis = 0; axis < 3; axis++) {
        points[0][axis] = random_.signed_unit();
        points[1][axis] = points[0][axis] + 0.3f * random_.signed_unit();
        points[2][axis] = points[1][axis] + 0.3f * random_.signed_unit();
        points[3][axis] = points[0][axis] + 0.3f * random_.signed_unit();
      }
      // Embree drops what is not finite.
      if (face % 40 == 39) points[0][0] = std::numeric_limits<float>::quiet_NaN();
      for (std::size_t corner = 0; corner < corners; corner++) {
        const auto vertex = static_cast<std::uint32_t>(corners * face + corner);
        std::memcpy(vertices + stride * vertex, points[corner], sizeof points[corner]);
        std::memcpy(indices + face_stride * face + 4 * corner, &vertex, sizeof vertex);
      }
    }
    rtcSetGeometryMask(geometry, 1u << (id % 3));
    rtcCommitGeometry(geometry);
    rtcAttachGeometryByID(scene_, geometry, id);
    geometries_.push_back(geometry);
  }

  RTCDevice device_;
  RTCScene scene_ = nullptr;
  Random random_;
  std::vector<RTCGeometry> geometries_;
  std::vector<RTCRayHit> rays_;
};

bool same(const std::vector<float>& a, const std::vector<float>& b) {
  const auto near = [](float x, float y) {
    return (x < 0) == (y < 0) && std::fabs(x - y) <= 1e-4f * std::fabs(x);
  };
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), near);
}

constexpr unsigned faces = 300;

void record(Program& program) {
  const std::vector<float> own = program.answers();
  CHECK(et_record_begin(program.scene(), "casts.rays", "built.bvh", 0) == ET_OK);
  CHECK(et_record_begin(program.scene(), "other.rays", "other.bvh", 0) == ET_ERROR_STATE);
  const std::vector<Asked> asked = program.ask_in_every_way();
  // A commit without a change is none.
  rtcCommitScene(program.scene());
  EtRecorded recorded{};
  CHECK(et_record_end(program.scene(), &recorded) == ET_OK);
  CHECK(recorded.queries == asked.size() && recorded.threads == 1 && recorded.unrecorded == 0);
  CHECK(recorded.lost_rejects == 0 && recorded.interrupted == 0 && recorded.rejects > 0);
  std::ofstream("asked.bin", std::ios::binary)
      .write(reinterpret_cast<const char*>(asked.data()),
             static_cast<std::streamsize>(asked.size() * sizeof asked[0]));
  CHECK(et_record_end(program.scene(), nullptr) == ET_ERROR_STATE);
  // Nothing of it is left, and the filters are the program's again.
  CHECK(same(program.answers(), own));

  CHECK(et_record_begin(program.scene(), "streams.rays", "streams.bvh", 0) == ET_OK);
  const auto [queries, hits] = program.ask_streams();
  CHECK(et_record_end(program.scene(), &recorded) == ET_OK);
  CHECK(recorded.queries == queries && recorded.unrecorded == 0);
  std::printf("%llu of %llu occluded in streams\n", static_cast<unsigned long long>(hits),
              static_cast<unsigned long long>(queries));

  // Several threads, some after others; of a scene that instances place, by way of those.
  CHECK(et_record_begin(program.scene(), "threads.rays", "threads.bvh", ET_RECORD_COMPRESSED) ==
        ET_OK);
  for (int round = 0; round < 3; round++) {
    std::vector<std::thread> threads;
    for (int thread = 0; thread < 3; thread++)
      threads.emplace_back([&] { CHECK(same(program.answers(), own)); });
    for (std::thread& thread : threads) thread.join();
  }
  const pid_t child = fork();
  if (child == 0)
    _exit(same(program.answers(), own) && et_record_end(program.scene(), nullptr) == ET_ERROR_STATE
              ? 0
              : 1);
  int status = 1;
  CHECK(waitpid(child, &status, 0) == child && status == 0);
  CHECK(et_record_end(program.scene(), &recorded) == ET_OK);
  CHECK(recorded.queries == 9 * 2 * own.size() && recorded.threads <= 3);

  RTCScene top = rtcNewScene(program.device());
  RTCGeometry instance = rtcNewGeometry(program.device(), RTC_GEOMETRY_TYPE_INSTANCE);
  rtcSetGeometryInstancedScene(instance, program.scene());
  rtcCommitGeometry(instance);
  rtcAttachGeometry(top, instance);
  rtcReleaseGeometry(instance);
  rtcCommitScene(top);
  CHECK(et_record_begin(top, "top.rays", "top.bvh", 0) == ET_ERROR_REFUSED);
  CHECK(et_record_begin(program.scene(), "instanced.rays", "instanced.bvh", 0) == ET_OK);
  CHECK(same(program.answers_of(top), own));
  CHECK(et_record_end(program.scene(), &recorded) == ET_OK && recorded.queries > 0);
  rtcReleaseScene(top);
}

void plant(Program& program, const char* tree) {
  const std::vector<float> own = program.answers();
  EtPlanted planted{};
  CHECK(et_plant(program.scene(), tree, &planted) == ET_OK);
  std::printf("%u trees, %u wide, %llu nodes\n", planted.trees, planted.width,
              static_cast<unsigned long long>(planted.nodes));
  CHECK(same(program.answers(), own));
  // Twice; in memory, at an odd address.
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK && same(program.answers(), own));
  std::ifstream file(tree, std::ios::binary);
  std::vector<char> bytes(1);
  bytes.insert(bytes.end(), std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>());
  CHECK(et_plant_memory(program.scene(), bytes.data() + 1, bytes.size() - 1, nullptr) == ET_OK);
  std::fill(bytes.begin(), bytes.end(), 0);
  CHECK(same(program.answers(), own));
  // What is no tree of it leaves the one that is there.
  CHECK(et_plant_memory(program.scene(), bytes.data(), bytes.size(), nullptr) == ET_ERROR_FILE &&
        same(program.answers(), own));
  CHECK(et_unplant(program.scene()) == ET_OK && same(program.answers(), own));
  CHECK(et_unplant(program.scene()) == ET_ERROR_STATE);

  // A recording of the planted tree.
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK);
  CHECK(et_record_begin(program.scene(), "planted.rays", "planted.bvh", 0) == ET_OK);
  CHECK(same(program.answers(), own));
  EtRecorded recorded{};
  CHECK(et_unplant(program.scene()) == ET_OK && same(program.answers(), own));
  CHECK(et_record_end(program.scene(), &recorded) == ET_OK && recorded.queries == 4 * own.size());

  // Threads that ask before and after.
  const auto ask = [&] {
    std::vector<std::thread> threads;
    for (int thread = 0; thread < 4; thread++)
      threads.emplace_back([&] { CHECK(same(program.answers(), own)); });
    for (std::thread& thread : threads) thread.join();
  };
  for (int round = 0; round < 3; round++) {
    ask();
    CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK);
    ask();
    CHECK(et_unplant(program.scene()) == ET_OK);
  }

  // Commits: none that counts; with a change, after which Embree has its own again; and with one
  // before et_unplant.
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK);
  rtcCommitScene(program.scene());
  CHECK(same(program.answers(), own));
  program.change();
  rtcCommitScene(program.scene());
  CHECK(same(program.answers(), own));
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK && same(program.answers(), own));
  program.change();
  rtcDetachGeometry(program.scene(), 7);
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_ERROR_REFUSED);
  CHECK(et_unplant(program.scene()) == ET_OK);
  rtcCommitScene(program.scene());
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_ERROR_REFUSED);
  rtcAttachGeometryByID(program.scene(), program.geometries()[1], 7);
  rtcCommitScene(program.scene());
  CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK && same(program.answers(), own));
  const pid_t child = fork();
  if (child == 0) {
    const bool good = same(program.answers(), own) && et_unplant(program.scene()) == ET_OK;
    _exit(good && same(program.answers(), own) ? 0 : 1);
  }
  int status = 1;
  CHECK(waitpid(child, &status, 0) == child && status == 0);

  // Released while planted, and what was its.
  RTCScene scene = program.scene();
  program.release();
  CHECK(et_unplant(scene) == ET_OK);
}

// The same scene on two devices, planted in by two threads.
void plant_on_two_devices(const char* config, int flags, const char* tree) {
  std::vector<std::thread> threads;
  for (int thread = 0; thread < 2; thread++) {
    threads.emplace_back([=] {
      Program program(config, flags, faces, 1);
      const std::vector<float> own = program.answers();
      for (int round = 0; round < 3; round++) {
        CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK && same(program.answers(), own));
        CHECK(et_plant(program.scene(), "no.bvh", nullptr) == ET_ERROR_FILE);
        CHECK(std::strncmp(et_error_message(), "no.bvh: cannot be read", 22) == 0);
        CHECK(et_unplant(program.scene()) == ET_OK && same(program.answers(), own));
      }
      CHECK(et_plant(program.scene(), tree, nullptr) == ET_OK);
    });
  }
  for (std::thread& thread : threads) thread.join();
}

void plant_files(Program& program) {
  const std::vector<float> own = program.answers();
  std::string path;
  while (std::getline(std::cin, path)) {
    const int code = et_plant(program.scene(), path.c_str(), nullptr);
    std::printf("%d %s\n", code, code == ET_OK ? "" : et_error_message());
    CHECK(same(program.answers(), own));
    if (code == ET_OK) CHECK(et_unplant(program.scene()) == ET_OK);
  }
}

void states(Program& program, const char* tree) {
  const std::vector<float> own = program.answers();
  // Handles of other kinds are no scenes.
  const auto as_scene = [](auto handle) { return reinterpret_cast<RTCScene>(handle); };
  for (RTCScene handle : {as_scene(program.device()), as_scene(program.geometries()[0]),
                          as_scene(program.geometries()[1])}) {
    CHECK(et_plant(handle, tree, nullptr) == ET_ERROR_ARGUMENT);
    CHECK(et_record_begin(handle, "no.rays", "no.bvh", 0) == ET_ERROR_ARGUMENT);
  }
  // Not committed, then empty.
  RTCScene scene = rtcNewScene(program.device());
  CHECK(et_plant(scene, tree, nullptr) == ET_ERROR_REFUSED);
  CHECK(std::strstr(et_error_message(), "has not been committed") != nullptr);
  CHECK(et_record_begin(scene, "no.rays", "no.bvh", 0) == ET_ERROR_REFUSED);
  CHECK(std::strstr(et_error_message(), "has not been committed") != nullptr);
  rtcCommitScene(scene);
  CHECK(et_plant(scene, tree, nullptr) == ET_ERROR_REFUSED);
  CHECK(et_record_begin(scene, "empty.rays", "empty.bvh", 0) == ET_OK &&
        et_record_end(scene, nullptr) == ET_OK);
  rtcReleaseScene(scene);
  // Files that cannot be made.
  CHECK(et_record_begin(program.scene(), "no/no.rays", "no.bvh", 0) == ET_ERROR_FILE);
  CHECK(et_record_begin(program.scene(), "no.rays", "no/no.bvh", 0) == ET_ERROR_FILE);
  CHECK(access("no.rays", F_OK) != 0 && access("no.bvh", F_OK) != 0);
  CHECK(et_plant(program.scene(), ".", nullptr) == ET_ERROR_FILE);
  // A commit with a change ends a recording.
  EtRecorded recorded{};
  CHECK(et_record_begin(program.scene(), "cut.rays", "cut.bvh", 0) == ET_OK);
  CHECK(same(program.answers(), own));
  program.change();
  rtcCommitScene(program.scene());
  CHECK(same(program.answers(), own));
  CHECK(et_record_end(program.scene(), &recorded) == ET_ERROR_STATE &&
        recorded.queries == 2 * own.size());
  CHECK(same(program.answers(), own));
  // More scenes than can be recorded; and a scene that is released meanwhile.
  std::vector<RTCScene> scenes;
  for (int number = 0; number < 17; number++) {
    scenes.push_back(rtcNewScene(program.device()));
    rtcAttachGeometryByID(scenes.back(), program.geometries()[2], 9);
    rtcCommitScene(scenes.back());
    const std::string name = "many." + std::to_string(number);
    const int code =
        et_record_begin(scenes.back(), (name + ".rays").c_str(), (name + ".bvh").c_str(), 0);
    CHECK(code == (number < 16 ? ET_OK : ET_ERROR_REFUSED));
  }
  for (RTCScene one : scenes) rtcReleaseScene(one);
  scenes.pop_back();
  for (RTCScene one : scenes) CHECK(et_record_end(one, nullptr) == ET_OK);
  // The geometry that they shared has its filter again.
  CHECK(same(program.answers(), own));
  // A full disk.
  CHECK(et_record_begin(program.scene(), "/dev/full", "full.bvh", 0) == ET_ERROR_FILE);
}

}  // namespace

int main(int count, char** words) {
  if (count < 4) return 2;
  const std::string what = words[1];
  const int flags = std::atoi(words[2]);
  Program program(words[3], flags, faces, 1);
  if (!program.is_there()) {
    std::printf("this processor has no %s\n", words[3]);
    return 0;
  }
  if (what == "record") record(program);
  if (what == "files") plant_files(program);
  if (what == "states" && count == 5) states(program, words[4]);
  if (what == "plant" && count == 5) {
    plant(program, words[4]);
    plant_on_two_devices(words[3], flags, words[4]);
  }
  return 0;
}
