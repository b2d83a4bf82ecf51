// The steps of planting, in order, and what was planted.
#include "plant.hpp"

#include <algorithm>
#include <cstring>
#include <string>
#include <utility>

namespace shim {
namespace {

// A scene whose geometries are those of the file.
Attached attached(const Ground& ground, const FileFaces* faces) {
  Attached scene;
  scene.device = ground.device;
  scene.scene = ground.scene;
  scene.version = ground.version;
  scene.bounds[0] = ground.bounds[0];
  scene.bounds[1] = ground.bounds[1];
  scene.spatial_splits = ground.spatial_splits;
  scene.others = ground.others;
  if (faces != nullptr) {
    scene.parts = faces->parts();
    scene.triangle_count = faces->triangle_count();
  }
  return scene;
}

void store_root(const LiveBvh& bvh, std::uint64_t root) noexcept {
  // Embree's object is written where the checks of the reader say that its root stands.
  auto* address = reinterpret_cast<std::uint64_t*>(bvh.root_address);
  __atomic_store_n(address, root, __ATOMIC_RELEASE);
}

// Embree's trees of triangles and quads, one of each kind at most.
std::vector<LiveBvh> plantable(const std::vector<LiveBvh>& bvhs) {
  std::vector<LiveBvh> found;
  for (const LiveBvh& bvh : bvhs) {
    if (bvh.block == nullptr) continue;
    if (bvh.quantised) throw Doubt("the scene's tree has quantised boxes, which are not planted");
    for (const LiveBvh& other : found) {
      if (other.block->corners == bvh.block->corners) {
        throw Doubt("the scene has two trees of one kind of primitives");
      }
    }
    found.push_back(bvh);
  }
  if (found.empty()) throw Doubt("the scene has no tree of triangles or quads");
  return found;
}

// Embree's own trees, read as those of the file's triangles.
std::vector<LiveBvh> read_own(const Attached& scene, const ShimFault* fault, LaneCheck& lanes) {
  try {
    return plantable(read_live_scene(scene, fault, &lanes, nullptr).bvhs);
  } catch (const Doubt& doubt) {
    // Most often the file is another scene's.
    throw Doubt(std::string("the scene's own tree is not one of the file's triangles: ") + doubt.what());
  }
}

// What is in memory is read as Embree's own was, and must be what was meant.
void check_read_back(Attached scene, const PlantedTree& planted,
                     const std::vector<PlantTree>& trees, const FileFaces& faces) {
  scene.spatial_splits = planted.splits();
  std::vector<LiveBvh> bvhs;
  for (const PlantedTree::Accel& accel : planted.accels()) {
    bvhs.push_back(accel.bvh);
    bvhs.back().root = accel.blocks.root;
  }
  const Tree found = read_tree_below(scene, bvhs, &planted);
  Tree meant = read_back(trees, faces);
  // The box of a root is not in memory: the scene's stands for it.
  const auto roots = static_cast<std::uint32_t>(trees.size() == 1 ? 1 : trees.size() + 1);
  for (std::uint32_t root = 0; root < roots; root++) meant.set_bounds(root, found.bounds(root));
  const std::size_t bytes = meant.nodes.size() * sizeof(ShimNode);
  if (found.nodes.size() != meant.nodes.size() || found.primitives != meant.primitives ||
      std::memcmp(found.nodes.data(), meant.nodes.data(), bytes) != 0) {
    throw Doubt("what was to be planted is read back as another tree");
  }
}

}  // namespace

PlantedTree::PlantedTree(std::vector<Accel> accels, bool splits)
    : accels_(std::move(accels)), splits_(splits) {}

void PlantedTree::make_current() const noexcept {
  for (const Accel& accel : accels_) store_root(accel.bvh, accel.blocks.root);
}

void PlantedTree::restore() const noexcept {
  for (const Accel& accel : accels_) store_root(accel.bvh, accel.bvh.root);
}

bool PlantedTree::is_current(const Ground& ground) const {
  const std::vector<LiveBvh> found = find_live_bvhs(attached(ground, nullptr), nullptr);
  return std::all_of(accels_.begin(), accels_.end(), [&](const Accel& accel) {
    return std::any_of(found.begin(), found.end(), [&](const LiveBvh& bvh) {
      return bvh.root == accel.blocks.root;
    });
  });
}

bool PlantedTree::is_restored(const Ground& ground) const {
  const std::vector<LiveBvh> found = find_live_bvhs(attached(ground, nullptr), nullptr);
  return std::all_of(accels_.begin(), accels_.end(), [&](const Accel& accel) {
    return std::any_of(found.begin(), found.end(), [&](const LiveBvh& bvh) {
      return bvh.root == accel.bvh.root && bvh.root_address == accel.bvh.root_address;
    });
  });
}

void PlantedTree::give_back(const Ground& ground) const {
  for (const LiveBvh& bvh : find_live_bvhs(attached(ground, nullptr), nullptr)) {
    for (const Accel& accel : accels_) {
      if (bvh.root != accel.blocks.root) continue;
      // Embree has moved it, and what has become of its own tree is not known.
      if (bvh.root_address != accel.bvh.root_address) throw Doubt("a tree of ours stands elsewhere");
      store_root(accel.bvh, accel.bvh.root);
    }
  }
}

const std::uint8_t* PlantedTree::places(std::uint64_t node) const noexcept {
  for (const Accel& accel : accels_) {
    const PlantedBlocks& blocks = accel.blocks;
    const std::uint64_t bytes =
        blocks.width == 8 ? sizeof(layout::BoxNode<8>) : sizeof(layout::BoxNode<4>);
    if (node < blocks.first_node || node >= blocks.first_node + blocks.nodes * bytes) continue;
    return blocks.places.data() + (node - blocks.first_node) / bytes * blocks.width;
  }
  return nullptr;
}

ShimPlanted PlantedTree::describe() const noexcept {
  ShimPlanted planted{};
  planted.trees = static_cast<std::uint32_t>(accels_.size());
  for (const Accel& accel : accels_) {
    planted.nodes += accel.blocks.nodes;
    planted.blocks += accel.blocks.blocks;
    planted.bytes += accel.blocks.pages.bytes();
    planted.stack = std::max(planted.stack, accel.blocks.stack);
    planted.width = std::max(planted.width, accel.blocks.width);
  }
  return planted;
}

std::unique_ptr<PlantedTree> plant(const Ground& ground, const ShimTreeFile& file,
                                   const ShimFault* fault) {
  if (file.flags & SHIM_FILE_FLATTENED) {
    throw Doubt("the file's triangles were placed by instances, and the scene has them as they are");
  }
  const FileFaces faces(file);
  const Attached scene = attached(ground, &faces);
  LaneCheck lanes(faces, ground.scene, ground.vertices);
  const std::vector<LiveBvh> bvhs = read_own(scene, fault, lanes);
  check_file_tree(file, faces);
  std::vector<PlantTree> trees;
  std::vector<PlantedTree::Accel> accels;
  for (const LiveBvh& bvh : bvhs) {
    trees.push_back(plant_tree(file, faces, bvh.block->corners));
    if (trees.back().nodes.empty()) throw Doubt("the file's tree has none of the scene's primitives");
    accels.push_back({bvh, plant_blocks(trees.back(), faces, bvh, lanes)});
  }
  auto planted =
      std::make_unique<PlantedTree>(std::move(accels), (file.flags & SHIM_FILE_SPLITS) != 0);
  check_read_back(scene, *planted, trees, faces);
  planted->make_current();
  return planted;
}

}  // namespace shim
