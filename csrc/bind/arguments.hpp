// What the core takes, as Python hands it over: arrays that are read where they lie, and held as long as their object.
#pragma once

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/factorised.hpp"
#include "core/filters.hpp"
#include "core/summation.hpp"

namespace pysas {

namespace py = pybind11;

template <typename T, int N>
View<T, N> view(const py::array& array) {
    if (array.ndim() != N || !py::isinstance<py::array_t<std::remove_const_t<T>>>(array)) {
        throw py::type_error("array of the wrong dtype or number of axes");
    }
    T* const data = const_cast<T*>(static_cast<const T*>(array.data()));
    return View<T, N>::of_bytes(data, array.shape(), array.strides());
}

template <typename T>
const T* pointer(const std::optional<py::array_t<T>>& array) {
    return array ? array->data() : nullptr;
}

template <typename T>
using Array = py::array_t<T, py::array::c_style>;

template <typename T>
const T* pointer(const std::optional<Array<T>>& array) {
    return array ? array->data() : nullptr;
}

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

inline Filter make_filter(const Array<double>& weight, const Array<std::int64_t>& first, int step, double error) {
    if (weight.ndim() != 3 || first.size() != weight.shape(0)) throw py::value_error("a filter: (phase, tap, power)");
    Filter filter;
    filter.phases = static_cast<int>(weight.shape(0));
    filter.taps = static_cast<int>(weight.shape(1));
    filter.degree = static_cast<int>(weight.shape(2)) - 1;
    filter.step = step;
    filter.error = error;
    filter.weight.assign(weight.data(), weight.data() + weight.size());
    filter.first.assign(first.data(), first.data() + first.size());
    return filter;
}

// How tables are read and delays formed: the polynomials of a sum.
struct Polynomials {
    int degree;
    std::vector<double> sine, cosine;
    Nodes nodes{};
    Polynomials(int degree, std::vector<double> sine, std::vector<double> cosine, const Array<double>& nodes,
                const Array<double>& fit)
        : degree(degree), sine(std::move(sine)), cosine(std::move(cosine)), nodes(nodes_of(nodes, fit)) {
        if (this->sine.size() > max_trig || this->cosine.size() > max_trig) throw py::value_error("too many terms");
    }
    static Nodes nodes_of(const Array<double>& at, const Array<double>& fit) {
        if (at.size() > max_nodes || fit.size() != max_nodes * max_nodes)
            throw py::value_error("nodes and their matrix");
        Nodes nodes{};
        nodes.count = static_cast<int>(at.size());
        std::copy_n(at.data(), nodes.count, nodes.at);
        std::copy_n(fit.data(), max_nodes * max_nodes, &nodes.fit[0][0]);
        return nodes;
    }
};

// (ny, nx, trace) weights, and the lattice's first place and steps: x, y, dx, dy, and how long lines are at most.
using LatticeArrays = std::optional<std::pair<Array<float>, Array<double>>>;

// Traces, what they have in common, and their weights on a lattice, all of them read where they lie.
struct Traces {
    py::array trace, model;
    int kind;
    LatticeArrays weights;
    Lattice lattice{};
    Traces(py::array trace, py::array model, int kind, LatticeArrays weights)
        : trace(std::move(trace)), model(std::move(model)), kind(kind), weights(std::move(weights)) {
        records<Trace>(this->trace, "trace");
        records<Model>(this->model, "model");
        if (this->model.size() != 1) throw py::value_error("model: expected one record");
        if (!this->weights) return;
        const auto& [value, axes] = *this->weights;
        if (value.ndim() != 3 || value.shape(0) < 4 || value.shape(1) < 4 || value.shape(2) != this->trace.size() ||
            axes.size() != 5)
            throw py::value_error(
                "a lattice: (ny, nx, trace) of at least 4 x 4 places, its first place, steps, longest line");
        lattice = {value.data(), value.shape(2), value.shape(1), value.shape(0), axes.at(0),
                   axes.at(1),   axes.at(2),     axes.at(3),     axes.at(4)};
    }
};

template <typename Real>
Terms<Real> terms_of(const py::array& table, const Polynomials& by, const Traces& traces) {
    const auto tables = view<const Real, 3>(table);
    Terms<Real> terms{};
    terms.table = tables.data;
    terms.trace_stride = tables.stride[0];
    terms.plane_stride = tables.stride[1];
    terms.degree = by.degree;
    terms.trig = static_cast<int>(by.sine.size());
    std::copy(by.sine.begin(), by.sine.end(), terms.sine);
    std::copy(by.cosine.begin(), by.cosine.end(), terms.cosine);
    terms.nodes = by.nodes;
    terms.traces = records<Trace>(traces.trace, "trace");
    terms.n_trace = traces.trace.size();
    terms.model = *records<Model>(traces.model, "model");
    terms.kind = static_cast<Kind>(traces.kind);
    terms.lattice = traces.weights ? &traces.lattice : nullptr;
    return terms;
}

// Lines, or points, of which `mask` says which are wanted, in blocks of `count`.
struct RasterArrays {
    std::optional<Array<double>> first, step, points;
    std::optional<Array<bool>> mask;
    int count;
    Raster of(std::int64_t height, std::int64_t width) const {
        return {pointer(first),
                pointer(step),
                pointer(points),
                mask ? reinterpret_cast<const std::uint8_t*>(mask->data()) : nullptr,
                height,
                width,
                count};
    }
};

// See pysas.engine.tree.SubImages for what the rows hold.
struct SubImageArrays {
    Array<double> place;
    Array<std::int64_t> shape;
    Array<std::int32_t> range;
    Array<float> store;
    std::vector<SubImage> images;
    SubImageArrays(Array<double> place, Array<std::int64_t> shape, Array<std::int32_t> range, Array<float> store)
        : place(std::move(place)), shape(std::move(shape)), range(std::move(range)), store(std::move(store)) {
        if (this->place.ndim() != 2 || this->shape.ndim() != 2 || this->place.shape(0) != this->shape.shape(0))
            throw py::value_error("sub-images: rows of places and shapes");
        images = sub_images(this->place.data(), this->shape.data(), this->place.shape(0), this->range.data(),
                            this->range.size(), this->store.mutable_data(), this->store.size());
    }
};

struct TreeOf {
    Taps taps{};
    Tree tree{};
    TreeOf(const Array<float>& even, const Array<float>& odd, const Array<float>& tap, const Array<float>& filter,
           double wave, const Polynomials& carrier) {
        taps = make_taps(static_cast<int>(2 * even.shape(0)), even.data(), odd.data(), tap.data(), filter.data(),
                         static_cast<int>(filter.size()) - 1);
        tree.taps = &taps;
        tree.wave = wave;
        std::copy(carrier.sine.begin(), carrier.sine.end(), tree.sine);
        std::copy(carrier.cosine.begin(), carrier.cosine.end(), tree.cosine);
        tree.nodes = carrier.nodes;
    }
    TreeOf(const TreeOf&) = delete;
};

inline Stack make_stack(const Array<double>& axis, const Array<double>& heights, int number) {
    if (axis.size() != 3 || heights.size() > max_planes || number >= heights.size())
        throw py::value_error("a stack: an axis and heights");
    Stack stack{};
    std::copy_n(axis.data(), 3, stack.axis);
    std::copy_n(heights.data(), heights.size(), stack.height);
    stack.count = static_cast<int>(heights.size());
    stack.number = number;
    return stack;
}

}  // namespace pysas
