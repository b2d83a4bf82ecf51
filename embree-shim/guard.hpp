// What stands between C++ exceptions and the C ABI.
#pragma once

#include <cstdio>
#include <new>
#include <utility>

#include "error.hpp"
#include "memory.hpp"

namespace shim {

inline void report(ShimError* error, int code, const char* message) noexcept {
  error->code = code;
  std::snprintf(error->message, sizeof error->message, "%s", message);
}

// Runs `work`; an exception becomes an error and `failure`.
template <typename Work>
auto guarded(ShimError* error, decltype(std::declval<Work>()()) failure, Work&& work) noexcept -> decltype(work()) {
  try {
    return work();
  } catch (const Error& caught) {
    report(error, caught.code(), caught.what());
  } catch (const Doubt& doubt) {
    report(error, SHIM_DOUBT, doubt.what());
  } catch (const std::bad_alloc&) {
    report(error, error_out_of_memory, "out of memory");
  } catch (const std::exception& caught) {
    report(error, error_unknown, caught.what());
  } catch (...) {
    report(error, error_unknown, "unknown exception");
  }
  return failure;
}

}  // namespace shim
