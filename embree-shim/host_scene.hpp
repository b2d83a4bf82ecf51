// A committed scene of the program that this library is linked with: all that is known of it is its
// handle.
//
// The handle is checked in memory before any call of Embree's gets it; then Embree is asked what a
// planter and a reader need. The scene is retained, so that it stays for as long as this object,
// whatever the program does.
#pragma once

#include <cstdint>
#include <memory>

#include "embree3.hpp"
#include "plant.hpp"

namespace shim {

class HostScene {
 public:
  // Throws Doubt when the handle is null, or leads to no scene of the libembree3 of this process.
  explicit HostScene(const void* handle);
  ~HostScene();
  HostScene(const HostScene&) = delete;
  HostScene& operator=(const HostScene&) = delete;

  RTCScene get() const noexcept { return scene_; }

  // What Embree says of the scene as it is committed now. Throws Doubt when it is not.
  Ground ground() const;
  // The same of the last commit, whatever the program has changed since: what is in memory, Embree
  // not being asked.
  Ground last_ground() const;

 private:
  Ground known() const;

  RTCScene scene_;
};

// What stands in such a scene in place of Embree's own trees, at most one tree at a time.
class HostPlanting {
 public:
  explicit HostPlanting(const HostScene& scene) noexcept : scene_(scene) {}
  // Gives Embree's own trees back. Where it cannot be known whether the scene still refers to ours,
  // its memory stays for good.
  ~HostPlanting();
  HostPlanting(const HostPlanting&) = delete;
  HostPlanting& operator=(const HostPlanting&) = delete;

  // Plants a tree in place of what stands there; throws Doubt when that is not possible, and then
  // that stays.
  ShimPlanted plant(const ShimTreeFile& file);
  // Gives Embree's own trees back, where the scene has ours, and frees them. Returns whether there
  // was anything. Throws Doubt when that cannot be known: then nothing is freed.
  bool restore();

  // What is traversed, in part or as a whole, in place of Embree's own; null when nothing is.
  const PlantedTree* current() const;

 private:
  const HostScene& scene_;
  std::unique_ptr<PlantedTree> planted_;
};

}  // namespace shim
