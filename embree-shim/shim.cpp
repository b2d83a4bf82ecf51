// The C ABI of shim.h: handles to objects, exceptions to errors; no work of its own.
#include <cstdio>
#include <memory>
#include <utility>

#include "embree_intersector.hpp"
#include "guard.hpp"
#include "recording_intersector.hpp"
#include "scene.hpp"
#include "shim.h"
#include "tree.hpp"

struct ShimScene {
  shim::Scene scene;
};

struct ShimIntersector {
  std::unique_ptr<shim::Intersector> intersector;
};

namespace {

// The tree behind a ShimTree, which must stay its first part.
struct OwnedTree {
  ShimTree view{};
  shim::Tree tree;
};

ShimTree* hand_over(shim::Tree tree) {
  auto owned = std::make_unique<OwnedTree>();
  owned->tree = std::move(tree);
  ShimTree& view = owned->view;
  view.nodes = owned->tree.nodes.data();
  view.node_count = owned->tree.nodes.size();
  view.primitives = owned->tree.primitives.data();
  view.primitive_count = owned->tree.primitives.size();
  view.splits = owned->tree.splits ? 1 : 0;
  std::snprintf(view.producer, sizeof view.producer, "%s", owned->tree.producer.c_str());
  return &owned.release()->view;
}

}  // namespace

uint32_t shim_version(void) {
  RTCDevice device = rtcNewDevice("threads=1");
  if (device == nullptr) return 0;
  const auto version = static_cast<uint32_t>(rtcGetDeviceProperty(device, RTC_DEVICE_PROPERTY_VERSION));
  rtcReleaseDevice(device);
  return version;
}

ShimScene* shim_scene_new(const ShimSettings* settings, const float* vertices, uint64_t vertex_count,
                          const ShimPart* parts, uint32_t part_count, ShimError* error) {
  return shim::guarded(error, static_cast<ShimScene*>(nullptr), [&] {
    return new ShimScene{{*settings, vertices, vertex_count, parts, part_count}};
  });
}

void shim_scene_free(ShimScene* scene) { delete scene; }

uint32_t shim_scene_update(ShimScene* scene, const float* vertices, uint64_t vertex_count, ShimError* error) {
  return shim::guarded(error, uint32_t{1}, [&] {
    scene->scene.update(vertices, vertex_count);
    return uint32_t{0};
  });
}

void shim_scene_bounds(const ShimScene* scene, float bounds[6]) {
  RTCBounds found;
  rtcGetSceneBounds(scene->scene.get(), &found);
  bounds[0] = found.lower_x;
  bounds[1] = found.lower_y;
  bounds[2] = found.lower_z;
  bounds[3] = found.upper_x;
  bounds[4] = found.upper_y;
  bounds[5] = found.upper_z;
}

uint64_t shim_scene_triangle_count(const ShimScene* scene) { return scene->scene.triangle_count(); }

uint64_t shim_scene_triangles(const ShimScene* scene, float* triangles) { return scene->scene.triangles(triangles); }

ShimTree* shim_tree_live(const ShimScene* scene, const ShimFault* fault, ShimError* error) {
  return shim::guarded(error, static_cast<ShimTree*>(nullptr),
                       [&] { return hand_over(scene->scene.live_tree(fault)); });
}

uint32_t shim_scene_plant(ShimScene* scene, const ShimTreeFile* file, const ShimFault* fault, ShimPlanted* planted,
                          ShimError* error) {
  return shim::guarded(error, uint32_t{1}, [&] {
    *planted = scene->scene.plant(*file, fault);
    return uint32_t{0};
  });
}

uint32_t shim_scene_choose(ShimScene* scene, uint32_t number) { return scene->scene.choose(number) ? 0 : 1; }

ShimTree* shim_tree_built(const ShimScene* scene, ShimError* error) {
  return shim::guarded(error, static_cast<ShimTree*>(nullptr),
                       [&] { return hand_over(shim::build_tree(scene->scene)); });
}

void shim_tree_free(ShimTree* tree) { delete reinterpret_cast<OwnedTree*>(tree); }

ShimIntersector* shim_intersector_new(const ShimScene* scene, ShimError* error) {
  return shim::guarded(error, static_cast<ShimIntersector*>(nullptr),
                       [&] { return new ShimIntersector{shim::make_embree_intersector(scene->scene)}; });
}

ShimIntersector* shim_recording_new(ShimIntersector* inner, ShimSink sink, ShimError* error) {
  // The handle goes on as that of the decorator: one handle, whatever stands behind it.
  std::unique_ptr<ShimIntersector> handle(inner);
  return shim::guarded(error, static_cast<ShimIntersector*>(nullptr), [&] {
    handle->intersector = shim::make_recording_intersector(std::move(handle->intersector), sink);
    return handle.release();
  });
}

void shim_intersector_free(ShimIntersector* intersector) { delete intersector; }

uint32_t shim_closest_hit(ShimIntersector* intersector, const ShimQuery* query, ShimHit* hit) {
  return static_cast<uint32_t>(intersector->intersector->closest_hit(*query, *hit));
}

uint32_t shim_occluded(ShimIntersector* intersector, const ShimQuery* query) {
  return static_cast<uint32_t>(intersector->intersector->occluded(*query));
}

void shim_closest_hits(ShimIntersector* intersector, const ShimQuery* queries, uint32_t width, ShimHit* hits,
                       uint32_t* outcomes) {
  shim::Outcome answers[16];
  intersector->intersector->closest_hits(queries, static_cast<shim::Width>(width), hits, answers);
  for (uint32_t lane = 0; lane < width; lane++) outcomes[lane] = static_cast<uint32_t>(answers[lane]);
}

void shim_occluded_packet(ShimIntersector* intersector, const ShimQuery* queries, uint32_t width, uint32_t* outcomes) {
  shim::Outcome answers[16];
  intersector->intersector->occluded_packet(queries, static_cast<shim::Width>(width), answers);
  for (uint32_t lane = 0; lane < width; lane++) outcomes[lane] = static_cast<uint32_t>(answers[lane]);
}

uint32_t shim_flush(ShimIntersector* intersector) { return intersector->intersector->flush() ? 0 : 1; }

uint64_t shim_refused(const ShimIntersector* intersector) { return intersector->intersector->refused(); }
