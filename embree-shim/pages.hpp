// Memory for what every query reads: large pages where the system gives them.
#pragma once

#include <cstddef>

namespace shim {

// Pages of the process's own, zero at first, freed with the object.
class Pages {
 public:
  Pages() = default;
  // Throws std::bad_alloc.
  explicit Pages(std::size_t bytes);
  ~Pages();
  Pages(Pages&& other) noexcept;
  Pages& operator=(Pages&& other) noexcept;

  unsigned char* data() const noexcept { return data_; }
  std::size_t bytes() const noexcept { return bytes_; }
  // From now on a write to it is a fault, which a debugger shows, and not a wrong tree.
  void make_read_only() noexcept;

 private:
  unsigned char* data_ = nullptr;
  std::size_t bytes_ = 0;  // of what is mapped
};

}  // namespace shim
