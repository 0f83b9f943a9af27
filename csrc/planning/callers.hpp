// Surveys, grids and wishes of C callers, checked, as the planner takes them.
#pragma once

#include <memory>

#include "planning/planner.hpp"
#include "pysas.h"

namespace pysas {

// Throw Error(argument) for what is null, not finite or out of range, Error(tolerance) for a tol no data can keep.
std::shared_ptr<const Scene> scene_of(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options);
Wish wish_of(const pysas_options& options);

}  // namespace pysas
