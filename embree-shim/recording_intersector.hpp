// The Intersector that records what another one is asked and answers.
#pragma once

#include <memory>

#include "intersector.hpp"

namespace shim {

std::unique_ptr<Intersector> make_recording_intersector(std::unique_ptr<Intersector> inner, ShimSink sink);

}  // namespace shim
