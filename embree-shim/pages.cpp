// Pages from mmap, aligned to 2 MB: only then can they be large ones, which bring 5 to 8% of a
// query's time (docs/planting.md).
#include "pages.hpp"

#include <sys/mman.h>

#include <cstdint>
#include <new>
#include <utility>

namespace shim {
namespace {

constexpr std::size_t large_page = std::size_t{2} << 20;
constexpr std::size_t small_page = 4096;

}  // namespace

Pages::Pages(std::size_t bytes) {
  if (bytes > SIZE_MAX / 2) throw std::bad_alloc();
  // What is smaller than a large page would only waste one.
  const std::size_t page = bytes < large_page ? small_page : large_page;
  const std::size_t needed = (bytes + page - 1) / page * page;
  const std::size_t room = page == large_page ? needed + large_page : needed;
  void* memory = mmap(nullptr, room, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
  if (memory == MAP_FAILED) throw std::bad_alloc();
  auto* begin = static_cast<unsigned char*>(memory);
  const std::size_t before = (page - reinterpret_cast<std::uintptr_t>(begin) % page) % page;
  const std::size_t behind = room - before - needed;
  // A failure to give the margins back leaves them mapped, untouched: address space, not memory.
  if (before != 0) munmap(begin, before);
  if (behind != 0) munmap(begin + before + needed, behind);
  data_ = begin + before;
  bytes_ = needed;
  // Advice: without large pages, small ones do.
  if (page == large_page) madvise(data_, bytes_, MADV_HUGEPAGE);
}

Pages::~Pages() {
  if (data_ != nullptr) munmap(data_, bytes_);
}

Pages::Pages(Pages&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), bytes_(std::exchange(other.bytes_, 0)) {}

Pages& Pages::operator=(Pages&& other) noexcept {
  std::swap(data_, other.data_);
  std::swap(bytes_, other.bytes_);
  return *this;
}

void Pages::make_read_only() noexcept {
  if (data_ != nullptr) mprotect(data_, bytes_, PROT_READ);
}

}  // namespace shim
