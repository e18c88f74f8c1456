// Structs of numbers that Python passes by name. fields(of, visit) lists the fields of a struct once: it calls
// visit(name, number) for each.
#pragma once
#include <cmath>
#include <cstddef>
#include <map>
#include <string>
#include <vector>

#include "checks.hpp"

namespace gp {

using Named = std::map<std::string, double>;

template <class Struct> std::vector<std::string> names_of() {
  std::vector<std::string> names;
  Struct of{};
  fields(of, [&](const std::string& name, double&) { names.push_back(name); });
  return names;
}

// Fills the fields; requires a finite number for each, and no other.
template <class Struct> void fill(Struct& of, const Named& given, const char* what) {
  size_t count = 0;
  fields(of, [&](const std::string& name, double& number) {
    const auto found = given.find(name);
    require(found != given.end() && std::fabs(found->second) <= kMaxNumber, what);
    number = found->second;
    ++count;
  });
  require(given.size() == count, what);
}

}  // namespace gp
