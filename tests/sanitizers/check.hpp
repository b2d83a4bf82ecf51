// What the C++ programs of the tests share: a check that ends the program, and random numbers.
#pragma once

#include <cstdint>
#include <cstdio>
#include <cstdlib>

// What is said behind a check that does not hold; a program may define it before.
#ifndef CHECK_SAID
#define CHECK_SAID ""
#endif

#define CHECK(holds)                                                                                 \
  do {                                                                                               \
    if (!(holds)) {                                                                                  \
      std::fprintf(stderr, "%s:%d: does not hold: %s %s\n", __FILE__, __LINE__, #holds, CHECK_SAID); \
      std::exit(1);                                                                                  \
    }                                                                                                \
  } while (false)

namespace checks {

// SplitMix64 (Steele, Lea and Flood 2014).
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t bits() {
    std::uint64_t z = state_ += 0x9E3779B97F4A7C15ull;
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9ull;
    z = (z ^ z >> 27) * 0x94D049BB133111EBull;
    return z ^ z >> 31;
  }
  std::uint32_t below(std::uint64_t n) { return static_cast<std::uint32_t>(bits() % n); }
  float unit() { return static_cast<float>(bits() >> 40) / static_cast<float>(1 << 24); }
  float signed_unit() { return 2 * unit() - 1; }

 private:
  std::uint64_t state_;
};

}  // namespace checks
