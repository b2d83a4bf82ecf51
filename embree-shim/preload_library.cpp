// Finds the real Embree: the next library in the search order, or, where the program loaded it privately (RTLD_LOCAL, as
// Python does with its modules), the one that is loaded by that name.
#include "preload_library.hpp"

#include <dlfcn.h>

#include <cstdio>
#include <cstdlib>
#include <cstring>

#include "preload_exchange.hpp"

namespace preload {
namespace {

constexpr const char* names[] = {"libembree3.so.3", "libembree3.so"};

void* find(const char* name, bool needed) noexcept {
  if (void* next = dlsym(RTLD_NEXT, name)) return next;
  for (const char* library : names) {
    // Not closed again: what it holds is in use.
    if (void* handle = dlopen(library, RTLD_NOLOAD | RTLD_NOW)) {
      if (void* function = dlsym(handle, name)) return function;
    }
  }
  if (needed) {
    std::fprintf(stderr, "embree-trace: error: %s is in no library that this program has loaded\n", name);
    std::abort();
  }
  return nullptr;
}

bool is_embree3(const void* function) noexcept {
  Dl_info info;
  return dladdr(function, &info) != 0 && info.dli_fname != nullptr && std::strstr(info.dli_fname, "libembree3") != nullptr;
}

Library load() noexcept {
  Library library;
  library.known = is_embree3(find("rtcNewScene", true));
  // Another version may lack what it was never asked for.
#define PRELOAD_FIND(name) library.name = reinterpret_cast<decltype(library.name)>(find(#name, library.known));
  PRELOAD_FUNCTIONS(PRELOAD_FIND)
#undef PRELOAD_FIND
  ExchangeHeader* header = exchange();
  if (header != nullptr && !library.known) store(header->foreign, 1u);
  return library;
}

}  // namespace

const Library& real() noexcept {
  static const Library library = load();
  return library;
}

}  // namespace preload
