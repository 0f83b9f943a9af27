// What the core takes, as Python hands it over: arrays that are read where they lie.
#pragma once

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>
#include <type_traits>

#include "core/views.hpp"

namespace pysas {

namespace py = pybind11;

template <typename T, int N>
View<T, N> view(const py::array& array) {
    if (array.ndim() != N || !py::isinstance<py::array_t<std::remove_const_t<T>>>(array)) {
        throw py::type_error("array of the wrong dtype or number of axes");
    }
    if (!std::is_const_v<T> && !array.writeable()) throw py::type_error("array that is not to be written");
    T* const data = const_cast<T*>(static_cast<const T*>(array.data()));
    return View<T, N>::of_bytes(data, array.shape(), array.strides());
}

template <typename T>
using Array = py::array_t<T, py::array::c_style>;

// The records of an array of one run, read where they lie.
template <typename T>
const T* records(const py::array& array, const char* name) {
    if (!py::isinstance<Array<T>>(array)) {
        const auto expected = py::str(py::dtype::of<T>()).cast<std::string>();
        throw py::type_error(std::string(name) + ": expected contiguous records of " + expected + ", found " +
                             py::str(array.dtype()).cast<std::string>());
    }
    return static_cast<const T*>(array.data());
}

}  // namespace pysas
