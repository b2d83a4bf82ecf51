// Reading memory whose layout is only believed: /proc/self/maps, and libembree3's segments.
#include "memory.hpp"

#include <link.h>

#include <algorithm>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <memory>

#ifdef __SANITIZE_ADDRESS__
#include <sanitizer/asan_interface.h>
#endif

namespace shim {
namespace {

const char* name(Object object) noexcept {
  switch (object) {
    case Object::scene: return "the scene";
    case Object::accel_list: return "the scene's list of acceleration structures";
    case Object::accel: return "an acceleration structure";
    case Object::bvh: return "a BVH";
    case Object::vtable: return "a vtable";
    case Object::code: return "a function";
    case Object::text: return "a name";
    case Object::node: return "a node";
    case Object::leaf: return "a leaf";
    case Object::vertex: return "a vertex";
  }
  return "an object";
}

// The file's name in a path.
const char* base_name(const char* path) noexcept {
  const char* slash = std::strrchr(path, '/');
  return slash == nullptr ? path : slash + 1;
}

int collect(dl_phdr_info* module, std::size_t, void* user) noexcept {
  constexpr const char* library = "libembree3.so";
  if (module->dlpi_name == nullptr) return 0;
  if (std::strncmp(base_name(module->dlpi_name), library, std::strlen(library)) != 0) return 0;
  try {
    Image& image = *static_cast<Image*>(user);
    for (int index = 0; index < module->dlpi_phnum; index++) {
      const auto& header = module->dlpi_phdr[index];
      if (header.p_type != PT_LOAD) continue;
      const std::uintptr_t begin = module->dlpi_addr + header.p_vaddr;
      const Range range{begin, begin + header.p_memsz};
      image.segments.push_back(range);
      if (header.p_flags & PF_X) image.code.push_back(range);
    }
  } catch (...) {
    static_cast<Image*>(user)->segments.clear();
  }
  return 1;
}

}  // namespace

bool covers(const std::vector<Range>& ranges, std::uintptr_t address, std::size_t bytes) noexcept {
  const auto after = std::upper_bound(ranges.begin(), ranges.end(), address,
                                      [](std::uintptr_t value, const Range& range) { return value < range.begin; });
  if (after == ranges.begin()) return false;
  const Range& range = *std::prev(after);
  return address < range.end && range.end - address >= bytes;
}

ProcessMemory::ProcessMemory() {
  std::unique_ptr<std::FILE, int (*)(std::FILE*)> maps(std::fopen("/proc/self/maps", "re"), &std::fclose);
  if (maps == nullptr) throw Doubt("/proc/self/maps cannot be read");
  char line[512];
  bool line_start = true;
  while (std::fgets(line, sizeof line, maps.get()) != nullptr) {
    const bool whole = std::strchr(line, '\n') != nullptr;
    std::uintptr_t begin = 0;
    std::uintptr_t end = 0;
    char readable = '-';
    if (line_start && std::sscanf(line, "%" SCNxPTR "-%" SCNxPTR " %c", &begin, &end, &readable) == 3 &&
        readable == 'r') {
      // An object may lie across two adjacent mappings.
      if (!readable_.empty() && readable_.back().end == begin) {
        readable_.back().end = end;
      } else {
        readable_.push_back({begin, end});
      }
    }
    line_start = whole;
  }
}

void ProcessMemory::read(Object object, std::uintptr_t address, void* out, std::size_t bytes) {
  // Nodes lie together, so most reads are in the range of the one before.
  const bool near = last_ < readable_.size() && address >= readable_[last_].begin && address < readable_[last_].end &&
                    readable_[last_].end - address >= bytes;
  if (!near) {
    if (!covers(readable_, address, bytes)) {
      throw Doubt(std::string("the pointer to ") + name(object) + " leads outside of mapped memory");
    }
    const auto after = std::upper_bound(readable_.begin(), readable_.end(), address,
                                        [](std::uintptr_t value, const Range& range) { return value < range.begin; });
    last_ = static_cast<std::size_t>(after - readable_.begin()) - 1;
  }
#ifdef __SANITIZE_ADDRESS__
  // Readable memory may belong to no object: a wrong pointer may lead there, a true one does not.
  if (__asan_region_is_poisoned(const_cast<void*>(reinterpret_cast<const void*>(address)), bytes) != nullptr) {
    throw Doubt(std::string("the pointer to ") + name(object) + " leads to no object");
  }
#endif
  std::memcpy(out, reinterpret_cast<const void*>(address), bytes);
}

void FaultyMemory::read(Object object, std::uintptr_t address, void* out, std::size_t bytes) {
  inner_.read(object, address, out, bytes);
  if (static_cast<std::uint32_t>(object) != fault_.object || reads_++ != fault_.nth) return;
  for (std::uint32_t index = 0; index < fault_.length; index++) {
    const std::size_t at = std::size_t{fault_.offset} + index;
    if (at >= bytes) return;
    auto& byte = static_cast<unsigned char*>(out)[at];
    byte = static_cast<unsigned char>((byte & fault_.keep[index]) ^ fault_.flip[index]);
  }
}

Image find_image() {
  Image image;
  dl_iterate_phdr(&collect, &image);
  const auto by_address = [](const Range& a, const Range& b) { return a.begin < b.begin; };
  std::sort(image.segments.begin(), image.segments.end(), by_address);
  std::sort(image.code.begin(), image.code.end(), by_address);
  return image;
}

}  // namespace shim
