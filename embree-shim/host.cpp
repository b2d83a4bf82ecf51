// The C ABI of shim.h for scenes of the program: handles to objects, exceptions to errors; no work
// of its own.
#include <cstdio>
#include <memory>
#include <utility>

#include "guard.hpp"
#include "host_faces.hpp"
#include "host_recording.hpp"
#include "host_scene.hpp"
#include "shim.h"

struct ShimHost {
  explicit ShimHost(const void* handle) : scene(handle), planting(scene) {}

  shim::HostScene scene;
  shim::HostPlanting planting;
  std::unique_ptr<shim::HostRecording> recording;
};

namespace {

// What is behind a ShimHostCapture, which must stay its first part.
struct OwnedCapture {
  explicit OwnedCapture(shim::HostCapture found) : capture(std::move(found)) {
    view.tree.nodes = capture.tree.nodes.data();
    view.tree.node_count = capture.tree.nodes.size();
    view.tree.primitives = capture.tree.primitives.data();
    view.tree.primitive_count = capture.tree.primitives.size();
    view.tree.splits = capture.tree.splits ? 1 : 0;
    std::snprintf(view.tree.producer, sizeof view.tree.producer, "%s",
                  capture.tree.producer.c_str());
    view.triangles = capture.triangles.data();
    view.triangle_count = capture.triangles.size() / 9;
    view.geometries = capture.geometries.data();
    view.geometry_count = capture.geometries.size();
    view.version = capture.version;
  }

  ShimHostCapture view{};
  shim::HostCapture capture;
};

const OwnedCapture& owned(const ShimHostCapture& view) {
  return reinterpret_cast<const OwnedCapture&>(view);
}

// Runs `work`, which returns nothing; non-zero when it throws.
template <typename Work>
uint32_t done(ShimError* error, Work&& work) noexcept {
  return shim::guarded(error, 1u, [&] {
    work();
    return 0u;
  });
}

}  // namespace

ShimHost* shim_host_new(const void* scene, ShimError* error) {
  return shim::guarded(error, static_cast<ShimHost*>(nullptr), [&] { return new ShimHost(scene); });
}

void shim_host_free(ShimHost* host) { delete host; }

uint32_t shim_host_plant(ShimHost* host, const ShimTreeFile* file, ShimPlanted* planted,
                         ShimError* error) {
  return done(error, [&] { *planted = host->planting.plant(*file); });
}

uint32_t shim_host_restore(ShimHost* host, ShimError* error) {
  return done(error, [&] { host->planting.restore(); });
}

ShimHostCapture* shim_host_capture(const ShimHost* host, ShimError* error) {
  return shim::guarded(error, static_cast<ShimHostCapture*>(nullptr), [&] {
    const shim::PlantedTree* planted = host->planting.current();
    auto made = std::make_unique<OwnedCapture>(shim::capture(host->scene, planted));
    made->view.planted = planted == nullptr ? 0 : 1;
    return &made.release()->view;
  });
}

void shim_host_capture_free(ShimHostCapture* capture) {
  delete reinterpret_cast<OwnedCapture*>(capture);
}

uint32_t shim_host_record(ShimHost* host, const ShimHostCapture* capture, ShimHostSink sink,
                          ShimError* error) {
  return done(error, [&] {
    host->recording =
        std::make_unique<shim::HostRecording>(host->scene, owned(*capture).capture.numbering, sink);
  });
}

void shim_host_end(ShimHost* host, ShimHostEnd* end) {
  *end = {};
  if (host->recording == nullptr) return;
  *end = host->recording->end();
  host->recording.reset();
}

void shim_host_label(uint32_t path, uint8_t depth, uint8_t purpose) {
  shim::label(path, depth, purpose);
}
