// What is known of the program's scenes and geometries, and the numbering that hits are recorded with.
#pragma once

#include <atomic>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

#include "asking.hpp"
#include "exchange.h"
#include "preload_library.hpp"
#include "preload_plant.hpp"

namespace preload {

struct Scene;

// One of the program's geometries. All but the counter is guarded by the registry's lock.
struct Geometry {
  struct Buffer {
    bool set = false;
    RTCFormat format = RTC_FORMAT_UNDEFINED;
    std::size_t stride = 0;
    std::size_t count = 0;
  };

  RTCGeometry handle = nullptr;
  RTCGeometryType type = RTC_GEOMETRY_TYPE_TRIANGLE;
  Buffer vertices;
  Buffer indices;
  std::uint32_t mask = 0xFFFFFFFFu;
  unsigned time_steps = 1;
  bool enabled = true;
  std::shared_ptr<Scene> instanced;
  std::uint64_t changes = 0;  // a scene that holds a changed geometry is another one at its next commit
  int references = 1;         // of the program's
};

// A committed scene: where hits are in TRIS. Does not change once made.
class Capture {
 public:
  // What has a geomID.
  struct Place {
    std::uint32_t kind = EXCHANGE_OTHER;
    bool moves = false;
    std::uint32_t first_triangle = 0;
    std::uint32_t primitives = 0;
    const Capture* instanced = nullptr;
  };

  explicit Capture(std::uint32_t index) noexcept : index_(index) {}
  ~Capture();
  Capture(const Capture&) = delete;
  Capture& operator=(const Capture&) = delete;

  // A hit's triangle.
  using Found = shim::asking::Found;

  // Of a quad, u and v say which half.
  Found triangle(std::uint32_t instance, std::uint32_t geometry, std::uint32_t primitive, float u, float v) const noexcept;

  std::uint32_t index() const noexcept { return index_; }
  // Whether it holds geometries that are left out, or that move: then its triangles cannot decide an occlusion.
  bool is_undecided() const noexcept { return others_ != 0 || moving_; }
  // Its number in the recording, given at the first call; EXCHANGE_SCENES when there is none left.
  std::uint32_t number() const noexcept;

 private:
  friend class Writer;

  std::uint32_t index_;
  std::vector<Place> places_;
  std::vector<std::shared_ptr<const Capture>> children_;
  std::uint64_t flattened_ = 0;
  std::uint32_t others_ = 0;
  bool moving_ = false;
  mutable std::once_flag numbered_;
  mutable std::uint32_t number_ = EXCHANGE_SCENES;
};

// One of the program's scenes. All but what `commit` guards and the atomic is guarded by the registry's lock.
struct Scene {
  RTCScene handle = nullptr;
  std::uint32_t index = 0;
  std::map<unsigned, std::shared_ptr<Geometry>> geometries;
  bool spatial_splits = false;
  std::uint64_t changes = 0;
  std::uint64_t revision = 0;  // commits so far that changed it
  int references = 1;
  std::shared_ptr<const Capture> capture;  // of the last commit
  std::uint64_t geometry = 0;              // a hash of what could be planted in, as it was committed last; 0: nothing

  std::atomic<bool> pending{false};  // committed, or being so, and not yet captured
  std::mutex commit;
  std::uint32_t commits = 0;
  // What was committed last, empty before: a commit without changes does nothing.
  std::vector<std::uint64_t> signature;
  Planting planting;
};

// What a capture is made of: a scene's geometries as they were when it was committed.
struct Attachment {
  unsigned id;
  std::shared_ptr<Geometry> geometry;  // keeps it alive
  Geometry state;                      // as it was
  std::shared_ptr<const Capture> instanced;
};

// Writes the scene's file, and returns the numbering; null, after `fail`, when that is not possible.
std::shared_ptr<const Capture> write_capture(const Scene& scene, const std::vector<Attachment>& attachments);

// Whether the program's scenes are followed: to record what is asked, or to plant.
bool follows() noexcept;

// Changes when a scene is committed or goes away: what was looked up before is then looked up again.
std::uint64_t epoch() noexcept;

// What a scene is told by: its index, and what was committed last.
struct Identity {
  std::uint32_t scene;
  std::uint64_t geometry;
};

// False when the scene is not known. For when a thread does not remember it: takes a lock.
bool identify(RTCScene scene, Identity& identity) noexcept;

// The last commit of a scene; null when it is not known. For when a thread does not remember it: takes a lock.
const Capture* capture_of(RTCScene scene) noexcept;

}  // namespace preload
