// Planting in one of the program's scenes: what stands there in place of Embree's own trees, from commit to commit.
#pragma once

#include <memory>
#include <vector>

#include "plant.hpp"
#include "preload_library.hpp"
#include "preload_trees.hpp"

namespace preload {

// A scene as it has been committed.
struct Committed {
  RTCScene handle;
  std::uint32_t scene;         // from 0
  std::uint32_t commit;        // of those with a change, from 0
  bool changed;                // since the commit before
  bool spatial_splits;         // whether its quality is high
  bool others;                 // whether it holds more than triangles and quads at one time
  std::vector<Count> counts;   // by geomID
};

// All calls are made under the scene's commit lock, but for the end, when Embree has released the scene.
class Planting {
 public:
  Planting() = default;
  ~Planting() = default;
  Planting(const Planting&) = delete;
  Planting& operator=(const Planting&) = delete;

  // Before every commit: Embree may refit the tree that it finds, so that is its own again.
  void before_commit() noexcept;
  // After every commit, before the program goes on.
  void after_commit(const Committed& scene) noexcept;

  // What is traversed in place of Embree's trees; null when those are.
  const shim::PlantedTree* current() const noexcept { return stands_ ? planted_.get() : nullptr; }

 private:
  bool returns(const Committed& scene) noexcept;
  bool plant(const Committed& scene, const Trees& trees, std::size_t number);

  std::unique_ptr<shim::PlantedTree> planted_;
  bool stands_ = false;
  bool told_ = false;       // that no tree has its geometries
  bool given_up_ = false;
  unsigned changes_ = 0;    // commits with changes at which there was a tree to try
};

}  // namespace preload
