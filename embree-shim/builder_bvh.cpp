// The tree of rtcBuildBVH, for when Embree's own cannot be read: boxes of triangles -> binary tree, one triangle a leaf.
#include <algorithm>
#include <cstring>
#include <memory>

#include "scene.hpp"
#include "tree.hpp"

namespace shim {
namespace {

// What the callbacks make, in memory that belongs to the RTCBVH.
struct BuiltNode {
  Bounds boxes[2];         // of the children
  BuiltNode* children[2];  // none in a leaf
  std::uint32_t child_count;
  std::uint32_t triangle_count;
  // triangle numbers follow in a leaf
};

std::uint32_t* triangles_of(BuiltNode* leaf) noexcept { return reinterpret_cast<std::uint32_t*>(leaf + 1); }

// The callbacks run on several threads; each only touches the node that it is given.
BuiltNode* allocate(RTCThreadLocalAllocator allocator, std::size_t triangles) {
  void* memory = rtcThreadLocalAlloc(allocator, sizeof(BuiltNode) + 4 * triangles, alignof(BuiltNode));
  auto* node = static_cast<BuiltNode*>(memory);
  node->child_count = 0;
  node->triangle_count = static_cast<std::uint32_t>(triangles);
  return node;
}

void* create_node(RTCThreadLocalAllocator allocator, unsigned int, void*) { return allocate(allocator, 0); }

void set_children(void* node, void** children, unsigned int count, void*) {
  auto* built = static_cast<BuiltNode*>(node);
  built->child_count = count;
  for (unsigned int child = 0; child < count; child++) built->children[child] = static_cast<BuiltNode*>(children[child]);
}

void set_bounds(void* node, const RTCBounds** bounds, unsigned int count, void*) {
  auto* built = static_cast<BuiltNode*>(node);
  for (unsigned int child = 0; child < count; child++) {
    const RTCBounds& box = *bounds[child];
    built->boxes[child] = {{box.lower_x, box.lower_y, box.lower_z}, {box.upper_x, box.upper_y, box.upper_z}};
  }
}

void* create_leaf(RTCThreadLocalAllocator allocator, const RTCBuildPrimitive* primitives, std::size_t count, void*) {
  BuiltNode* leaf = allocate(allocator, count);
  for (std::size_t index = 0; index < count; index++) triangles_of(leaf)[index] = primitives[index].primID;
  return leaf;
}

// The boxes of all triangles that Embree would keep; primID is the number in TRIS.
std::vector<RTCBuildPrimitive> boxes_of(const Scene& scene) {
  std::vector<RTCBuildPrimitive> boxes;
  boxes.reserve(scene.triangle_count());
  for (const Part& part : scene.parts()) {
    for (std::uint64_t face = 0; face < part.faces; face++) {
      if (!part.keeps(face)) continue;
      for (std::uint32_t half = 0; half < part.triangles_per_face(); half++) {
        const Bounds bounds = part.bounds(face, half);
        RTCBuildPrimitive box;
        box.lower_x = bounds.lower[0];
        box.lower_y = bounds.lower[1];
        box.lower_z = bounds.lower[2];
        box.geomID = 0;
        box.upper_x = bounds.upper[0];
        box.upper_y = bounds.upper[1];
        box.upper_z = bounds.upper[2];
        box.primID = part.first_triangle + part.triangles_per_face() * static_cast<std::uint32_t>(face) + half;
        boxes.push_back(box);
      }
    }
  }
  return boxes;
}

struct ReleaseBvh {
  void operator()(RTCBVH bvh) const noexcept { rtcReleaseBVH(bvh); }
};

// Builds within `max_depth`; null when that is not deep enough. The builder reorders its input, hence the copy.
BuiltNode* build(const Scene& scene, RTCBVH bvh, std::vector<RTCBuildPrimitive> boxes, unsigned int max_depth) {
  RTCBuildArguments arguments = rtcDefaultBuildArguments();
  // HIGH would need a split callback, and is medium without one.
  arguments.buildQuality = std::min(scene.quality(), RTC_BUILD_QUALITY_MEDIUM);
  arguments.maxBranchingFactor = 2;
  arguments.maxDepth = max_depth;
  arguments.minLeafSize = 1;
  arguments.maxLeafSize = 1;
  arguments.bvh = bvh;
  arguments.primitives = boxes.data();
  arguments.primitiveCount = boxes.size();
  arguments.primitiveArrayCapacity = boxes.size();
  arguments.createNode = create_node;
  arguments.setNodeChildren = set_children;
  arguments.setNodeBounds = set_bounds;
  arguments.createLeaf = create_leaf;
  return static_cast<BuiltNode*>(rtcBuildBVH(&arguments));
}

}  // namespace

Tree build_tree(const Scene& scene) {
  Tree tree;
  const auto version = static_cast<std::uint32_t>(
      rtcGetDeviceProperty(scene.device().get(), RTC_DEVICE_PROPERTY_VERSION));
  tree.producer = library_name(version) + " rtcBuildBVH";
  tree.nodes.resize(1);
  const std::vector<RTCBuildPrimitive> boxes = boxes_of(scene);
  // The builder never reports the root's box.
  Bounds all = Bounds::empty();
  for (const RTCBuildPrimitive& box : boxes) {
    all.extend({{box.lower_x, box.lower_y, box.lower_z}, {box.upper_x, box.upper_y, box.upper_z}});
  }
  tree.set_bounds(0, all);
  if (boxes.empty()) {
    tree.make_leaf(0);
    return tree;
  }

  const std::unique_ptr<RTCBVHTy, ReleaseBvh> bvh(rtcNewBVH(scene.device().get()));
  scene.device().check("cannot create a BVH");
  BuiltNode* root = nullptr;
  constexpr unsigned int deepest = 1024;
  for (unsigned int depth = 64; root == nullptr && depth <= deepest; depth *= 2) {
    root = build(scene, bvh.get(), boxes, depth);
    // Too shallow is an error of the device, which the next, deeper one must not inherit.
    if (root == nullptr && depth == deepest) scene.device().check("rtcBuildBVH failed");
    if (root == nullptr) rtcGetDeviceError(scene.device().get());
  }
  if (root == nullptr) throw Error(RTC_ERROR_UNKNOWN, "rtcBuildBVH returned nothing");

  struct Pending {
    BuiltNode* built;
    std::uint32_t node;
  };
  std::vector<Pending> pending{{root, 0}};
  while (!pending.empty()) {
    const auto [built, node] = pending.back();
    pending.pop_back();
    if (built->child_count == 0) {
      tree.make_leaf(node);
      for (std::uint32_t index = 0; index < built->triangle_count; index++) {
        tree.add_primitive(node, triangles_of(built)[index]);
      }
      continue;
    }
    const std::uint32_t first = tree.make_inner(node, built->child_count);
    for (std::uint32_t child = built->child_count; child-- > 0;) {
      tree.set_bounds(first + child, built->boxes[child]);
      pending.push_back({built->children[child], first + child});
    }
  }
  return tree;
}

}  // namespace shim
