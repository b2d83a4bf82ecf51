// The Intersector that asks Embree.
#pragma once

#include <memory>

#include "intersector.hpp"
#include "scene.hpp"

namespace shim {

// `scene` must outlive what is returned.
std::unique_ptr<Intersector> make_embree_intersector(const Scene& scene);

}  // namespace shim
