// Planting: a tree of a `.bvh` in place of the ones that Embree built for a committed scene, so
// that Embree's own kernels traverse it.
//
// A file's arrays -> parts (plant_file) and checks (plant_check, plant_cover); the live trees, read
// with all their checks against those parts (live_bvh, plant_lanes); the file's tree by kind of
// face (plant_tree); nodes and blocks (plant_blocks, pages), read back before anything refers to
// them; then one atomic store for each of Embree's trees. Nothing in here calls Embree, but
// `vertices`.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "live_bvh.hpp"
#include "plant_blocks.hpp"
#include "plant_lanes.hpp"

namespace shim {

// A committed scene, as its API tells of it. What is not known is left as it is.
struct Ground {
  const void* device = nullptr;
  const void* scene = nullptr;
  std::uint32_t version = 0;   // RTC_DEVICE_PROPERTY_VERSION
  Bounds bounds[2];            // rtcGetSceneLinearBounds
  bool spatial_splits = true;  // whether the scene's quality lets Embree split triangles
  bool others = true;          // whether the scene may hold what is no triangle or quad, or moves
  VertexData vertices = nullptr;
};

// Trees of ours in a live scene. The scene must not traverse them any more when this goes away: it
// was released, or committed with a change, or `restore` was called since it was committed.
class PlantedTree final : public SlotOrder {
 public:
  // One of Embree's trees, and what stands in for it.
  struct Accel {
    LiveBvh bvh;  // as Embree made it
    PlantedBlocks blocks;
  };

  PlantedTree(std::vector<Accel> accels, bool splits);

  // From now on queries traverse ours, or Embree's: both are valid, so others may be asking. Only
  // until the next commit.
  void make_current() const noexcept;
  void restore() const noexcept;

  // Whether the scene still traverses all of ours after another commit. Throws Doubt when that
  // cannot be known: then this must never go away.
  bool is_current(const Ground& ground) const;
  // Whether, after `restore` and another commit, the scene still traverses the trees that ours can
  // take the place of again. Throws Doubt when that cannot be known.
  bool is_restored(const Ground& ground) const;

  // As `restore`, for those who do not know whether the scene was committed since: a tree that the
  // scene has no more is left alone. Afterwards this may go away. Throws Doubt when it cannot be
  // known: then this must never go away.
  void give_back(const Ground& ground) const;

  // The order of the file in place of the slots'.
  const std::uint8_t* places(std::uint64_t node) const noexcept override;

  const std::vector<Accel>& accels() const noexcept { return accels_; }
  // Whether a primitive may stand in several leaves.
  bool splits() const noexcept { return splits_; }
  // For the C ABI; without a number.
  ShimPlanted describe() const noexcept;

 private:
  std::vector<Accel> accels_;
  bool splits_;
};

// Checks the file and the scene, and makes the file's tree the one that is traversed. To be called
// after a commit and before anyone asks, by one thread. Throws Doubt when anything is not as it
// must be, and then has changed nothing; a fault, for tests, falsifies what is read of the scene.
std::unique_ptr<PlantedTree> plant(const Ground& ground, const ShimTreeFile& file,
                                   const ShimFault* fault);

}  // namespace shim
