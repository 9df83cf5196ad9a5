// What lenslet.cpp adds to the module.
#pragma once
#include <nanobind/nanobind.h>

namespace lfrig::sim {

void bind_lenslets(nanobind::module_ &m);

}  // namespace lfrig::sim
