// The program's filter functions, wrapped so that the candidates that they reject are recorded.
#pragma once

#include "preload_library.hpp"

namespace preload {

// A function that does what `filter` does and notes what it rejects; null for null, and the same for one that is wrapped
// already. After `fail`, when the program has more filter functions than there are wrappers, `filter` itself.
RTCFilterFunctionN wrapped(RTCFilterFunctionN filter) noexcept;

}  // namespace preload
