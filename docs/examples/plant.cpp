// A small renderer that records what it asks, and renders on a better tree.
//
//   g++ -std=c++17 -O2 plant.cpp -lembree_trace -lembree3 -o plant
//   ./plant                                               records into casts.rays and built.bvh
//   bvh-build built.bvh ours.bvh --rays casts.rays        makes a tree from that
//   ./plant ours.bvh                                      renders on Embree's tree, then on that
//   one
//
// The scene, a lawn of thin blades under a light, is generated here.
#include <embree3/rtcore.h>
#include <embree_trace/plant.h>

#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <limits>
#include <vector>

namespace {

constexpr unsigned width = 160;
constexpr unsigned height = 120;
constexpr unsigned blades = 20000;

// A linear congruential generator (Knuth, MMIX).
class Random {
 public:
  float unit() {
    state_ = state_ * 6364136223846793005u + 1442695040888963407u;
    return static_cast<float>(state_ >> 40) / static_cast<float>(1 << 24);
  }

 private:
  std::uint64_t state_ = 1;
};

RTCScene make_scene(RTCDevice device) {
  RTCGeometry geometry = rtcNewGeometry(device, RTC_GEOMETRY_TYPE_TRIANGLE);
  auto* vertices = static_cast<float*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3, 3 * sizeof(float), 3 * blades));
  auto* indices = static_cast<unsigned*>(rtcSetNewGeometryBuffer(
      geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3, 3 * sizeof(unsigned), blades));
  Random random;
  for (unsigned blade = 0; blade < blades; blade++) {
    const float x = 20 * random.unit() - 10;
    const float z = 20 * random.unit();
    const float lean = random.unit() - 0.5f;
    const float corners[9] = {
        x, 0, z, x + 0.05f, 0, z + 0.02f, x + lean, 0.5f + random.unit(), z + lean};
    std::memcpy(vertices + 9 * blade, corners, sizeof corners);
    for (unsigned corner = 0; corner < 3; corner++)
      indices[3 * blade + corner] = 3 * blade + corner;
  }
  rtcCommitGeometry(geometry);
  RTCScene scene = rtcNewScene(device);
  rtcAttachGeometry(scene, geometry);
  rtcReleaseGeometry(geometry);
  rtcCommitScene(scene);
  return scene;
}

RTCRay ray_from(const float (&from)[3], float x, float y, float z) {
  RTCRay ray{};
  ray.org_x = from[0];
  ray.org_y = from[1];
  ray.org_z = from[2];
  ray.dir_x = x;
  ray.dir_y = y;
  ray.dir_z = z;
  ray.tnear = 1e-4f;
  ray.tfar = std::numeric_limits<float>::infinity();
  ray.mask = 0xFFFFFFFFu;
  return ray;
}

// Where each camera ray hits, negative where the light does not reach, and 0 where there is
// nothing.
std::vector<float> render(RTCScene scene) {
  std::vector<float> image;
  image.reserve(width * height);
  RTCIntersectContext context;
  rtcInitIntersectContext(&context);
  for (unsigned pixel = 0; pixel < width * height; pixel++) {
    const float x = (static_cast<float>(pixel % width) + 0.5f) / width - 0.5f;
    const float y = 0.4f - (static_cast<float>(pixel) / width + 0.5f) / height;
    const float eye[3] = {0, 1.2f, -3};
    RTCRayHit asked{};
    asked.ray = ray_from(eye, x, y, 1);
    asked.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    // Says what the next query is for: only recordings need it.
    et_record_label(pixel, 0, ET_PURPOSE_CAMERA);
    rtcIntersect1(scene, &context, &asked);
    if (asked.hit.geomID == RTC_INVALID_GEOMETRY_ID) {
      image.push_back(0);
      continue;
    }
    const float t = asked.ray.tfar;
    const float point[3] = {eye[0] + t * x, eye[1] + t * y, eye[2] + t};
    RTCRay shadow = ray_from(point, 0.3f, 1, 0.2f);
    shadow.tnear = 1e-3f;
    et_record_label(pixel, 1, ET_PURPOSE_SHADOW);
    rtcOccluded1(scene, &context, &shadow);
    image.push_back(shadow.tfar < 0 ? -t : t);
  }
  return image;
}

double seconds_of(RTCScene scene, std::vector<float>& image) {
  const auto start = std::chrono::steady_clock::now();
  image = render(scene);
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Pixels that differ by more than Embree's own trees among each other.
unsigned differences(const std::vector<float>& a, const std::vector<float>& b) {
  unsigned found = 0;
  for (std::size_t pixel = 0; pixel < a.size(); pixel++) {
    if (!(std::fabs(a[pixel] - b[pixel]) <= 1e-4f * std::fabs(a[pixel]))) found++;
  }
  return found;
}

int failed() {
  std::fprintf(stderr, "plant: error: %s\n", et_error_message());
  return 2;
}

int record(RTCScene scene) {
  if (et_record_begin(scene, "casts.rays", "built.bvh", ET_RECORD_COMPRESSED) != ET_OK)
    return failed();
  render(scene);
  EtRecorded recorded;
  if (et_record_end(scene, &recorded) != ET_OK) return failed();
  std::printf("%llu queries in casts.rays, the tree in built.bvh\n",
              static_cast<unsigned long long>(recorded.queries));
  return 0;
}

int compare(RTCScene scene, const char* tree) {
  std::vector<float> own;
  std::vector<float> planted;
  const double before = seconds_of(scene, own);
  EtPlanted what;
  if (et_plant(scene, tree, &what) != ET_OK) return failed();
  const double after = seconds_of(scene, planted);
  if (et_unplant(scene) != ET_OK) return failed();
  const unsigned different = differences(own, planted);
  std::printf("%u of %u pixels differ; %.2f of the time, on a tree of %llu nodes\n", different,
              width * height, after / before, static_cast<unsigned long long>(what.nodes));
  return different == 0 ? 0 : 1;
}

}  // namespace

int main(int count, char** words) {
  RTCDevice device = rtcNewDevice(nullptr);
  if (device == nullptr) return 2;
  RTCScene scene = make_scene(device);
  const int code = count < 2 ? record(scene) : compare(scene, words[1]);
  rtcReleaseScene(scene);
  rtcReleaseDevice(device);
  return code;
}
