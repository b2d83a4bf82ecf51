// Decorates the calls that make, fill and commit scenes: follows which geometries are attached where, and has every
// committed scene planted in and captured, before the program can change what it was built from.
//
// The registry is never freed: the program may use Embree until its last moment. One lock guards it; no query takes it but
// the first of a thread after a commit.
#include <pthread.h>

#include <new>
#include <unordered_map>
#include <utility>
#include <vector>

#include "preload_exchange.hpp"
#include "preload_scenes.hpp"

namespace preload {
namespace {

struct Registry {
  std::mutex lock;
  std::unordered_map<RTCScene, std::shared_ptr<Scene>> scenes;
  std::unordered_map<RTCGeometry, std::shared_ptr<Geometry>> geometries;
  std::uint32_t scene_count = 0;
  std::atomic<std::uint64_t> epoch{1};
};

Registry* made() noexcept;

Registry& registry() noexcept {
  static Registry* const registry = made();
  return *registry;
}

// A fork copies the locks as they are, and not the threads that hold them.
Registry* made() noexcept {
  pthread_atfork([] { registry().lock.lock(); }, [] { registry().lock.unlock(); },
                 [] {
                   for (auto& [handle, scene] : registry().scenes) new (&scene->commit) std::mutex();
                   registry().lock.unlock();
                 });
  return new Registry;
}

// Runs `work` under the lock, unless this process is not followed. What cannot be followed ends the recording, not the program.
template <typename Work>
void follow(Work&& work) noexcept {
  if (!follows()) return;
  try {
    const std::lock_guard<std::mutex> lock(registry().lock);
    work(registry());
  } catch (...) {
    fail("there is no memory left to follow the program's scenes");
  }
}

template <typename Map, typename Key>
typename Map::mapped_type find(const Map& map, Key key) {
  const auto found = map.find(key);
  return found == map.end() ? nullptr : found->second;
}

// What neither the program nor Embree has any more, to be freed behind the lock, and once Embree has let go of it: a scene may have a
// tree of ours in it.
using Gone = std::vector<std::shared_ptr<void>>;

// Takes an object out of the registry when that is its only other owner: the program has released it, and it is attached to nothing.
template <typename Map, typename Object>
bool is_let_go(Map& map, const std::shared_ptr<Object>& object) {
  if (object == nullptr || object->references > 0 || object.use_count() != 2) return false;
  const auto found = map.find(object->handle);
  // The handle may be another's by now.
  if (found == map.end() || found->second != object) return false;
  map.erase(found);
  return true;
}

void let_go(Registry& registry, std::shared_ptr<Scene> scene, Gone& gone);

// The same, and then of what only it kept: the scene that it instances.
void let_go(Registry& registry, std::shared_ptr<Geometry> geometry, Gone& gone) {
  if (!is_let_go(registry.geometries, geometry)) return;
  let_go(registry, std::move(geometry->instanced), gone);
  gone.push_back(std::move(geometry));
}

void let_go(Registry& registry, std::shared_ptr<Scene> scene, Gone& gone) {
  if (!is_let_go(registry.scenes, scene)) return;
  for (auto& [id, geometry] : scene->geometries) let_go(registry, std::move(geometry), gone);
  scene->geometries.clear();
  gone.push_back(std::move(scene));
}

// Runs `change` on a geometry, if it is known.
template <typename Change>
void change_geometry(RTCGeometry handle, Change&& change) noexcept {
  follow([&](Registry& registry) {
    if (const auto geometry = find(registry.geometries, handle)) {
      change(*geometry);
      geometry->changes++;
    }
  });
}

template <typename Change>
void change_scene(RTCScene handle, Change&& change) noexcept {
  follow([&](Registry& registry) {
    if (const auto scene = find(registry.scenes, handle)) {
      change(*scene);
      scene->changes++;
    }
  });
}

void set_buffer(RTCGeometry handle, RTCBufferType type, unsigned slot, RTCFormat format, std::size_t stride,
                std::size_t count) noexcept {
  // Further slots are the vertices of later time steps.
  if (slot != 0) return;
  change_geometry(handle, [&](Geometry& geometry) {
    const Geometry::Buffer buffer{true, format, stride, count};
    if (type == RTC_BUFFER_TYPE_VERTEX) geometry.vertices = buffer;
    if (type == RTC_BUFFER_TYPE_INDEX) geometry.indices = buffer;
  });
}

void attach(RTCScene scene, RTCGeometry geometry, unsigned id) noexcept {
  follow([&](Registry& registry) {
    const auto into = find(registry.scenes, scene);
    const auto what = find(registry.geometries, geometry);
    if (into == nullptr || what == nullptr) return;
    into->geometries[id] = what;
    into->changes++;
  });
}

// What makes a commit another one. Called with the registry's lock.
std::vector<std::uint64_t> signature_of(const Scene& scene) {
  std::vector<std::uint64_t> signature{scene.changes};
  for (const auto& [id, geometry] : scene.geometries) {
    if (!geometry->enabled) continue;
    const std::uint64_t instanced = geometry->instanced == nullptr ? 0 : geometry->instanced->revision;
    signature.insert(signature.end(),
                     {id, reinterpret_cast<std::uintptr_t>(geometry.get()), geometry->changes, instanced});
  }
  return signature;
}

// The scene for the planter, without its number of commits.
Committed committed(const Scene& scene, const std::vector<Attachment>& attachments) {
  Committed found{scene.handle, scene.index, 0, false, scene.spatial_splits, false, {}};
  for (const Attachment& attachment : attachments) {
    const Geometry& geometry = attachment.state;
    const bool quads = geometry.type == RTC_GEOMETRY_TYPE_QUAD;
    if ((!quads && geometry.type != RTC_GEOMETRY_TYPE_TRIANGLE) || geometry.time_steps > 1) {
      found.others = true;
      continue;
    }
    const std::uint64_t faces = geometry.vertices.set && geometry.indices.set ? geometry.indices.count : 0;
    if (faces != 0) found.counts.push_back({attachment.id, quads ? 1u : 0u, quads ? 2 * faces : faces});
  }
  return found;
}

// FNV-1a of what a scene's geometries tell without a look at their vertices; the same in every run of a program.
std::uint64_t hash_of(const std::vector<Count>& counts) noexcept {
  if (counts.empty()) return 0;
  std::uint64_t hash = 0xCBF29CE484222325ull;
  const auto add = [&](std::uint64_t value) {
    for (unsigned byte = 0; byte < sizeof value; byte++) hash = (hash ^ (value >> 8 * byte & 0xFF)) * 0x100000001B3ull;
  };
  for (const Count& count : counts) {
    add(count.geometry);
    add(count.kind);
    add(count.triangles);
  }
  return hash;
}

// Plants in the scene as it was committed last and captures it, if nobody has. Called without the registry's lock.
void capture(Scene& scene) {
  const std::lock_guard<std::mutex> lock(scene.commit);
  if (!scene.pending.load(std::memory_order_acquire)) return;
  std::vector<Attachment> attachments;
  std::vector<std::uint64_t> signature;
  Committed now{};
  {
    const std::lock_guard<std::mutex> reading(registry().lock);
    signature = signature_of(scene);
    for (const auto& [id, geometry] : scene.geometries) {
      if (!geometry->enabled) continue;
      std::shared_ptr<const Capture> instanced;
      if (geometry->instanced != nullptr) instanced = geometry->instanced->capture;
      attachments.push_back({id, geometry, *geometry, std::move(instanced)});
    }
    now = committed(scene, attachments);
  }
  now.commit = scene.commits;
  now.changed = signature != scene.signature;
  scene.planting.after_commit(now);
  std::shared_ptr<const Capture> made = scene.capture;
  if (exchange() != nullptr && (made == nullptr || now.changed)) made = write_capture(scene, attachments);
  const std::lock_guard<std::mutex> writing(registry().lock);
  if (now.changed) {
    scene.signature = std::move(signature);
    scene.commits++;
    scene.revision++;
  }
  scene.capture.swap(made);
  scene.geometry = hash_of(now.counts);
  scene.pending.store(false, std::memory_order_release);
  registry().epoch.fetch_add(1, std::memory_order_acq_rel);
}

std::shared_ptr<Scene> scene_of(RTCScene handle) {
  const std::lock_guard<std::mutex> lock(registry().lock);
  return find(registry().scenes, handle);
}

// Threads that join a commit come here also while others are in it, or behind it and asking already.
void before_commit(RTCScene handle) noexcept {
  if (!follows()) return;
  try {
    const auto scene = scene_of(handle);
    if (scene == nullptr) return;
    const std::lock_guard<std::mutex> lock(scene->commit);
    scene->planting.before_commit();
    scene->pending.store(true, std::memory_order_release);
  } catch (...) {
    fail("there is no memory left to follow the program's scenes");
  }
}

void after_commit(RTCScene handle) noexcept {
  if (!follows()) return;
  try {
    if (const auto scene = scene_of(handle)) capture(*scene);
  } catch (...) {
    fail("there is no memory left to capture a scene");
  }
}

// Runs `use` on a scene as it was committed last, if it is known.
template <typename Use>
void look_up(RTCScene handle, Use&& use) noexcept {
  try {
    const auto scene = scene_of(handle);
    if (scene == nullptr) return;
    // Another thread's commit may have returned later than this one's, when both joined it.
    if (scene->pending.load(std::memory_order_acquire)) capture(*scene);
    const std::lock_guard<std::mutex> lock(registry().lock);
    use(*scene);
  } catch (...) {
    // Without memory it is not known.
  }
}

}  // namespace

bool follows() noexcept { return (exchange() != nullptr || trees() != nullptr) && real().is_known(); }

std::uint64_t epoch() noexcept { return registry().epoch.load(std::memory_order_acquire); }

const Capture* capture_of(RTCScene handle) noexcept {
  const Capture* found = nullptr;
  look_up(handle, [&](const Scene& scene) { found = scene.capture.get(); });
  return found;
}

bool identify(RTCScene handle, Identity& identity) noexcept {
  bool found = false;
  look_up(handle, [&](const Scene& scene) {
    identity = {scene.index, scene.geometry};
    found = true;
  });
  return found;
}

}  // namespace preload

using namespace preload;

// The decorated calls, under Embree's names and with its prototypes.

RTCScene rtcNewScene(RTCDevice device) {
  called_from(__builtin_return_address(0));
  RTCScene handle = real().rtcNewScene(device);
  if (handle == nullptr) return handle;
  follow([&](Registry& registry) {
    auto scene = std::make_shared<Scene>();
    scene->handle = handle;
    scene->index = registry.scene_count++;
    registry.scenes[handle] = std::move(scene);
    registry.epoch.fetch_add(1, std::memory_order_acq_rel);
  });
  return handle;
}

void rtcRetainScene(RTCScene scene) {
  real().rtcRetainScene(scene);
  change_scene(scene, [](Scene& scene) {
    scene.references++;
    scene.changes--;
  });
}

void rtcReleaseScene(RTCScene scene) {
  Gone gone;
  follow([&](Registry& registry) {
    auto last = find(registry.scenes, scene);
    if (last == nullptr || --last->references > 0) return;
    let_go(registry, std::move(last), gone);
    registry.epoch.fetch_add(1, std::memory_order_acq_rel);
  });
  real().rtcReleaseScene(scene);
}

unsigned int rtcAttachGeometry(RTCScene scene, RTCGeometry geometry) {
  const unsigned id = real().rtcAttachGeometry(scene, geometry);
  attach(scene, geometry, id);
  return id;
}

void rtcAttachGeometryByID(RTCScene scene, RTCGeometry geometry, unsigned int id) {
  real().rtcAttachGeometryByID(scene, geometry, id);
  attach(scene, geometry, id);
}

void rtcDetachGeometry(RTCScene scene, unsigned int id) {
  real().rtcDetachGeometry(scene, id);
  Gone gone;
  change_scene(scene, [&](Scene& scene) {
    const auto found = scene.geometries.find(id);
    if (found == scene.geometries.end()) return;
    auto last = std::move(found->second);
    scene.geometries.erase(found);
    let_go(registry(), std::move(last), gone);
  });
}

void rtcCommitScene(RTCScene scene) {
  before_commit(scene);
  real().rtcCommitScene(scene);
  after_commit(scene);
}

void rtcJoinCommitScene(RTCScene scene) {
  before_commit(scene);
  real().rtcJoinCommitScene(scene);
  after_commit(scene);
}

void rtcSetSceneBuildQuality(RTCScene scene, RTCBuildQuality quality) {
  real().rtcSetSceneBuildQuality(scene, quality);
  change_scene(scene, [&](Scene& scene) { scene.spatial_splits = quality == RTC_BUILD_QUALITY_HIGH; });
}

void rtcSetSceneFlags(RTCScene scene, RTCSceneFlags flags) {
  real().rtcSetSceneFlags(scene, flags);
  change_scene(scene, [](Scene&) {});
}

RTCGeometry rtcNewGeometry(RTCDevice device, RTCGeometryType type) {
  called_from(__builtin_return_address(0));
  RTCGeometry handle = real().rtcNewGeometry(device, type);
  if (handle == nullptr) return handle;
  follow([&](Registry& registry) {
    auto geometry = std::make_shared<Geometry>();
    geometry->handle = handle;
    geometry->type = type;
    if (real().version == Version::four) geometry->mask = embree4::default_mask;
    registry.geometries[handle] = std::move(geometry);
  });
  return handle;
}

void rtcRetainGeometry(RTCGeometry geometry) {
  real().rtcRetainGeometry(geometry);
  change_geometry(geometry, [](Geometry& geometry) {
    geometry.references++;
    geometry.changes--;
  });
}

void rtcReleaseGeometry(RTCGeometry geometry) {
  Gone gone;
  follow([&](Registry& registry) {
    auto last = find(registry.geometries, geometry);
    if (last == nullptr || --last->references > 0) return;
    let_go(registry, std::move(last), gone);
  });
  real().rtcReleaseGeometry(geometry);
}

void rtcCommitGeometry(RTCGeometry geometry) {
  real().rtcCommitGeometry(geometry);
  change_geometry(geometry, [](Geometry&) {});
}

void rtcEnableGeometry(RTCGeometry geometry) {
  real().rtcEnableGeometry(geometry);
  change_geometry(geometry, [](Geometry& geometry) { geometry.enabled = true; });
}

void rtcDisableGeometry(RTCGeometry geometry) {
  real().rtcDisableGeometry(geometry);
  change_geometry(geometry, [](Geometry& geometry) { geometry.enabled = false; });
}

void rtcSetGeometryTimeStepCount(RTCGeometry geometry, unsigned int count) {
  real().rtcSetGeometryTimeStepCount(geometry, count);
  change_geometry(geometry, [&](Geometry& geometry) { geometry.time_steps = count; });
}

void rtcSetGeometryMask(RTCGeometry geometry, unsigned int mask) {
  real().rtcSetGeometryMask(geometry, mask);
  change_geometry(geometry, [&](Geometry& geometry) { geometry.mask = mask; });
}

void rtcSetGeometryBuffer(RTCGeometry geometry, RTCBufferType type, unsigned int slot, RTCFormat format, RTCBuffer buffer,
                          size_t offset, size_t stride, size_t count) {
  real().rtcSetGeometryBuffer(geometry, type, slot, format, buffer, offset, stride, count);
  set_buffer(geometry, type, slot, format, stride, count);
}

void rtcSetSharedGeometryBuffer(RTCGeometry geometry, RTCBufferType type, unsigned int slot, RTCFormat format,
                                const void* data, size_t offset, size_t stride, size_t count) {
  real().rtcSetSharedGeometryBuffer(geometry, type, slot, format, data, offset, stride, count);
  set_buffer(geometry, type, slot, format, stride, count);
}

void* rtcSetNewGeometryBuffer(RTCGeometry geometry, RTCBufferType type, unsigned int slot, RTCFormat format, size_t stride,
                              size_t count) {
  void* data = real().rtcSetNewGeometryBuffer(geometry, type, slot, format, stride, count);
  if (data != nullptr) set_buffer(geometry, type, slot, format, stride, count);
  return data;
}

// Embree 4.4's.
extern "C" {

__attribute__((visibility("default"))) void rtcSetSharedGeometryBufferHostDevice(
    RTCGeometry geometry, RTCBufferType type, unsigned slot, RTCFormat format, const void* data, const void* device_data,
    std::size_t offset, std::size_t stride, std::size_t count) {
  real().rtcSetSharedGeometryBufferHostDevice(geometry, type, slot, format, data, device_data, offset, stride, count);
  set_buffer(geometry, type, slot, format, stride, count);
}

__attribute__((visibility("default"))) void rtcSetNewGeometryBufferHostDevice(
    RTCGeometry geometry, RTCBufferType type, unsigned slot, RTCFormat format, std::size_t stride, std::size_t count,
    void** data, void** device_data) {
  real().rtcSetNewGeometryBufferHostDevice(geometry, type, slot, format, stride, count, data, device_data);
  set_buffer(geometry, type, slot, format, stride, count);
}

}

void rtcUpdateGeometryBuffer(RTCGeometry geometry, RTCBufferType type, unsigned int slot) {
  real().rtcUpdateGeometryBuffer(geometry, type, slot);
  change_geometry(geometry, [](Geometry&) {});
}

void rtcSetGeometryInstancedScene(RTCGeometry geometry, RTCScene scene) {
  real().rtcSetGeometryInstancedScene(geometry, scene);
  Gone gone;
  follow([&](Registry& registry) {
    const auto instance = find(registry.geometries, geometry);
    if (instance == nullptr) return;
    let_go(registry, std::exchange(instance->instanced, find(registry.scenes, scene)), gone);
    instance->changes++;
  });
}

void rtcSetGeometryTransform(RTCGeometry geometry, unsigned int step, RTCFormat format, const void* transform) {
  real().rtcSetGeometryTransform(geometry, step, format, transform);
  change_geometry(geometry, [](Geometry&) {});
}

void rtcSetGeometryTransformQuaternion(RTCGeometry geometry, unsigned int step, const RTCQuaternionDecomposition* transform) {
  real().rtcSetGeometryTransformQuaternion(geometry, step, transform);
  change_geometry(geometry, [](Geometry&) {});
}
