// Something that Embree refused; never crosses the C ABI (guard.hpp).
#pragma once

#include <stdexcept>
#include <string>

namespace shim {

// Of RTCError, the same in Embree 3 and 4.
constexpr int error_unknown = 1;
constexpr int error_out_of_memory = 4;

class Error : public std::runtime_error {
 public:
  // `code` is Embree's RTCError.
  Error(int code, const std::string& message) : std::runtime_error(message), code_(code) {}
  int code() const noexcept { return code_; }

 private:
  int code_;
};

}  // namespace shim
