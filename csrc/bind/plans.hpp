// Plans for Python.
#pragma once

#include <pybind11/pybind11.h>

namespace pysas {

// Add Survey, Pixels, Scene, Plan, Done to the module.
void bind_plans(pybind11::module_& m);

}  // namespace pysas
