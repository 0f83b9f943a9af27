// The Python face of the C++ core: pysas.engine._core. Bindings only make views, call the core and turn errors into
// exceptions; pysas/engine/_core.pyi is the list of what stands here, and a test compares the two.

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <algorithm>
#include <complex>
#include <iterator>
#include <optional>
#include <string>
#include <vector>

#include "core/arcs.hpp"
#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/factorised.hpp"
#include "core/filters.hpp"
#include "core/leaving.hpp"
#include "core/subapertures.hpp"
#include "core/summation.hpp"

namespace py = pybind11;

namespace {

using namespace pysas;
using py::operator""_a;

#define PYSAS_TEXT_OF(x) #x
#define PYSAS_TEXT(x) PYSAS_TEXT_OF(x)

const char* compiler() {
#if defined(__clang__)
    return "clang " __clang_version__;
#elif defined(__GNUC__)
    return "gcc " __VERSION__;
#elif defined(_MSC_VER)
    return "msvc " PYSAS_TEXT(_MSC_VER);
#else
    return "unknown";
#endif
}

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

// Releases the GIL. While the interpreter ends, whoever takes it again is unwound by pthread_exit, which no destructor
// survives: such threads stay outside.
class Released {
  public:
    Released() {
        leaving::off();
        state_ = PyEval_SaveThread();
    }
    ~Released() {
        leaving::back();
        PyEval_RestoreThread(state_);
        leaving::home();
    }
    Released(const Released&) = delete;

  private:
    PyThreadState* state_;
};

// Progress, Ctrl-C and the interpreter's end: runs in the calling thread, which does not hold the GIL.
Tick ticker(const py::object& tick) {
    return [&tick](double share) {
        if (leaving::stopping()) return false;
        const py::gil_scoped_acquire gil;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (!tick.is_none()) tick(share);
        return true;
    };
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

py::tuple design_filter(double band, int degree, int phases, int step, double error, int least, int most) {
    const Filter filter = design(band, degree, phases, step, error, least, most, false);
    py::array_t<double> weight({filter.phases, filter.taps, filter.degree + 1}, filter.weight.data());
    py::array_t<std::int64_t> first(static_cast<py::ssize_t>(filter.first.size()), filter.first.data());
    return py::make_tuple(weight, first, filter.error);
}

py::array_t<double> trace_peaks(const py::array& data, const Array<std::int64_t>& begin, const Array<std::int64_t>& end,
                                int threads, const py::object& tick) {
    if (data.ndim() != 3 || begin.size() != data.shape(0) * data.shape(1) || end.size() != begin.size())
        throw py::value_error("peaks: traces, and where each begins and ends");
    py::array_t<double> out({data.shape(0), data.shape(1)});
    double* to = out.mutable_data();
    const std::int64_t *from = begin.data(), *until = end.data();
    const Tick check = ticker(tick);
    const auto call = [&](auto kind) {
        const auto traces = view<const decltype(kind), 3>(data);
        const Released gil;
        peaks(traces, from, until, to, threads, check);
    };
    if (data.itemsize() == 8)
        call(std::complex<float>());
    else
        call(std::complex<double>());
    return out;
}

py::array_t<double> squares_about(const py::array& data, const Array<std::int64_t>& trace,
                                  const Array<std::int64_t>& place, std::int64_t reach, double scale, int threads,
                                  const py::object& tick) {
    if (trace.size() != place.size()) throw py::value_error("a place for each trace number");
    py::array_t<double> out(trace.size());
    double* to = out.mutable_data();
    const Tick check = ticker(tick);
    const auto call = [&](auto kind) {
        const auto traces = view<const decltype(kind), 3>(data);
        const Places places{trace.data(), place.data(), trace.size(), reach};
        const Released gil;
        mean_squares(traces, places, scale, to, threads, check);
    };
    if (data.itemsize() == 8)
        call(std::complex<float>());
    else
        call(std::complex<double>());
    return out;
}

void prepare_batch(const py::array& data, const Array<std::int64_t>& order, const Array<std::int64_t>& start,
                   const std::optional<py::array_t<std::complex<double>>>& weights, double scale,
                   const Array<double>& weight, const Array<std::int64_t>& first, int step, std::int64_t length,
                   const py::array& table, int threads, const std::string& isa, const py::object& tick) {
    Filter filter;
    filter.phases = static_cast<int>(weight.shape(0));
    filter.taps = static_cast<int>(weight.shape(1));
    filter.degree = static_cast<int>(weight.shape(2)) - 1;
    filter.step = step;
    filter.weight.assign(weight.data(), weight.data() + weight.size());
    filter.first.assign(first.data(), first.data() + first.size());
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const auto call = [&](auto sample, auto real) {
        using Sample = decltype(sample);
        using Real = decltype(real);
        const auto to = view<Real, 3>(table);
        const Batch<Sample> batch{
            view<const Sample, 3>(data), order.data(), start.data(), pointer(weights), order.size(), length, scale};
        const Released gil;
        prepare(kernels, batch, filter, to.data, to.stride[1], threads, check);
    };
    if (data.itemsize() == 8)
        call(std::complex<float>(), float());
    else if (table.itemsize() == 4)
        call(std::complex<double>(), float());
    else
        call(std::complex<double>(), double());
}

// What the kernels sum; nodes of delay polynomials apart.
template <typename Real>
Terms<Real> terms_of(const py::array& table, int degree, const std::vector<double>& sine,
                     const std::vector<double>& cosine, const py::array& trace, const py::array& model, int kind) {
    const auto tables = view<const Real, 3>(table);
    Terms<Real> terms{};
    terms.table = tables.data;
    terms.trace_stride = tables.stride[0];
    terms.plane_stride = tables.stride[1];
    terms.degree = degree;
    terms.trig = static_cast<int>(sine.size());
    std::copy(sine.begin(), sine.end(), terms.sine);
    std::copy(cosine.begin(), cosine.end(), terms.cosine);
    terms.traces = records<Trace>(trace, "trace");
    terms.n_trace = trace.size();
    const Model* const shared = records<Model>(model, "model");
    if (model.size() != 1) throw py::value_error("model: expected one record");
    terms.model = *shared;
    terms.kind = static_cast<Kind>(kind);
    return terms;
}

// (ny, nx, trace) weights, and the lattice's first place and steps: x, y, dx, dy, and how long lines are at most.
using LatticeArrays = std::optional<std::pair<Array<float>, Array<double>>>;

Lattice lattice_of(const LatticeArrays& arrays, std::int64_t traces) {
    if (!arrays) return {};
    const auto& [value, axes] = *arrays;
    if (value.ndim() != 3 || value.shape(0) < 4 || value.shape(1) < 4 || value.shape(2) != traces || axes.size() != 5)
        throw py::value_error(
            "a lattice: (ny, nx, trace) of at least 4 x 4 places, its first place, steps, longest line");
    return {value.data(), traces,     value.shape(1), value.shape(0), axes.at(0),
            axes.at(1),   axes.at(2), axes.at(3),     axes.at(4)};
}

std::int64_t add_batch(const py::array& table, int degree, const std::vector<double>& sine,
                       const std::vector<double>& cosine, const py::array& trace, const py::array& model, int kind,
                       const Array<double>& nodes, const Array<double>& fit,
                       const std::optional<py::array_t<double>>& first, const std::optional<py::array_t<double>>& step,
                       const std::optional<py::array_t<double>>& points, const std::optional<py::array_t<bool>>& mask,
                       int count, const LatticeArrays& weights, const std::optional<py::array>& own,
                       const py::array& image, int threads, const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const Lattice lattice = lattice_of(weights, trace.size());
    const auto call = [&](auto real, auto pixel) {
        using Real = decltype(real);
        Terms<Real> terms = terms_of<Real>(table, degree, sine, cosine, trace, model, kind);
        terms.lattice = weights ? &lattice : nullptr;
        terms.nodes.count = static_cast<int>(nodes.size());
        std::copy_n(nodes.data(), terms.nodes.count, terms.nodes.at);
        std::copy_n(fit.data(), max_nodes * max_nodes, &terms.nodes.fit[0][0]);
        const auto to = view<decltype(pixel), 2>(image);
        if (own) {
            const auto each = view<const Real, 2>(*own);
            if (!points || each.shape[0] < (to.shape[1] + count - 1) / count * count ||
                each.shape[1] != terms.n_trace || each.stride[0] != terms.n_trace || each.stride[1] != 1)
                throw py::value_error("own weights: (point, trace) of whole blocks of points");
            terms.weights = each.data;
        }
        const Raster raster{pointer(first),
                            pointer(step),
                            pointer(points),
                            mask ? reinterpret_cast<const std::uint8_t*>(mask->data()) : nullptr,
                            to.shape[0],
                            to.shape[1],
                            count};
        const Released gil;
        return add(kernels, terms, raster, to, threads, check);
    };
    if (table.itemsize() == 8) return call(double(), std::complex<double>());
    if (image.itemsize() == 8) return call(float(), std::complex<float>());
    return call(float(), std::complex<double>());
}

py::array_t<std::uint64_t> view_arcs(const py::array& trace, int channels, double cos_beam, const Array<double>& points,
                                     const Array<std::int64_t>& order, const py::array& out, int threads,
                                     const py::object& tick) {
    const Tick check = ticker(tick);
    if (points.ndim() != 2 || points.shape(1) != 3) throw py::value_error("arcs: rows of points");
    const Viewers viewers{records<Trace>(trace, "trace"), trace.size(), channels, cos_beam};
    py::array_t<std::uint64_t> pattern(points.shape(0));
    std::uint64_t* const patterns = pattern.mutable_data();
    const auto call = [&](auto real) {
        const auto to = view<decltype(real), 2>(out);
        if (to.shape[0] < points.shape(0) || to.shape[1] != order.size() || to.stride[0] != order.size() ||
            to.stride[1] != 1)
            throw py::value_error("arcs: out of (point, trace)");
        const Released gil;
        arcs(viewers, points.data(), points.shape(0), order.data(), order.size(), to.data, patterns, threads, check);
    };
    if (out.itemsize() == 4)
        call(float());
    else
        call(double());
    return pattern;
}

// See pysas.engine.tree.SubImages for what the rows hold.
std::vector<SubImage> images_of(const Array<double>& place, const Array<std::int64_t>& shape,
                                const Array<std::int32_t>& range, Array<float>& store) {
    if (place.ndim() != 2 || shape.ndim() != 2 || place.shape(0) != shape.shape(0))
        throw py::value_error("sub-images: rows of places and shapes");
    return sub_images(place.data(), shape.data(), place.shape(0), range.data(), range.size(), store.mutable_data(),
                      store.size());
}

struct TreeOf {
    Taps taps{};
    Tree tree{};
    TreeOf(const Array<float>& even, const Array<float>& odd, const Array<float>& tap, const Array<float>& filter,
           double wave, const std::vector<double>& sine, const std::vector<double>& cosine, const Array<double>& nodes,
           const Array<double>& fit) {
        taps = make_taps(static_cast<int>(2 * even.shape(0)), even.data(), odd.data(), tap.data(), filter.data(),
                         static_cast<int>(filter.size()) - 1);
        tree.taps = &taps;
        tree.wave = wave;
        std::copy(sine.begin(), sine.end(), tree.sine);
        std::copy(cosine.begin(), cosine.end(), tree.cosine);
        tree.nodes.count = Sizes<float>::nodes;
        std::copy_n(nodes.data(), tree.nodes.count, tree.nodes.at);
        std::copy_n(fit.data(), max_nodes * max_nodes, &tree.nodes.fit[0][0]);
    }
    TreeOf(const TreeOf&) = delete;
};

void fill_leaves(const TreeOf& tree, const Array<float>& table, int degree, const std::vector<double>& sine,
                 const std::vector<double>& cosine, const py::array& trace, const py::array& model, int kind,
                 const Array<std::int64_t>& span, const Array<double>& place, const Array<std::int64_t>& shape,
                 const Array<std::int32_t>& range, const LatticeArrays& weights, Array<float> store, double slack,
                 bool smooth, int threads, const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const auto images = images_of(place, shape, range, store);
    Terms<float> terms = terms_of<float>(table, degree, sine, cosine, trace, model, kind);
    terms.nodes = tree.tree.nodes;
    const Lattice lattice = lattice_of(weights, trace.size());
    terms.lattice = weights ? &lattice : nullptr;
    const std::int64_t* spans = span.data();
    const Released gil;
    leaves(kernels, tree.tree, terms, spans, images.data(), static_cast<std::int64_t>(images.size()), slack, smooth,
           threads, check);
}

void merge_sub_images(const TreeOf& tree, const Array<std::int64_t>& span, const Array<double>& child_place,
                      const Array<std::int64_t>& child_shape, const Array<std::int32_t>& child_range,
                      Array<float> child_store, const Array<double>& place, const Array<std::int64_t>& shape,
                      const Array<std::int32_t>& range, Array<float> store, bool add, bool last, bool smooth,
                      int threads, const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const auto children = images_of(child_place, child_shape, child_range, child_store);
    const auto images = images_of(place, shape, range, store);
    const std::int64_t* spans = span.data();
    const Released gil;
    merge(kernels, tree.tree, children.data(), spans, images.data(), static_cast<std::int64_t>(images.size()), add,
          last, smooth, threads, check);
}

void read_sub_image(const TreeOf& tree, const Array<double>& place, const Array<std::int64_t>& shape,
                    const Array<std::int32_t>& range, Array<float> store,
                    const std::optional<py::array_t<double>>& first, const std::optional<py::array_t<double>>& step,
                    const std::optional<Array<double>>& points, const std::optional<Array<double>>& axis,
                    const std::optional<Array<double>>& heights, int number,
                    const std::optional<py::array_t<bool>>& mask, int count, const Array<std::uint8_t>& wanted,
                    const py::array& image, int threads, const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const auto from = images_of(place, shape, range, store);
    Stack stack{};
    if (points) {
        if (!axis || !heights || axis->size() != 3 || heights->size() > max_planes || number >= heights->size())
            throw py::value_error("points: an axis and heights");
        std::copy_n(axis->data(), 3, stack.axis);
        std::copy_n(heights->data(), heights->size(), stack.height);
        stack.count = static_cast<int>(heights->size());
        stack.number = number;
    }
    const auto call = [&](auto pixel) {
        const auto to = view<decltype(pixel), 2>(image);
        const Raster raster{pointer(first),
                            pointer(step),
                            points ? points->data() : nullptr,
                            mask ? reinterpret_cast<const std::uint8_t*>(mask->data()) : nullptr,
                            to.shape[0],
                            to.shape[1],
                            count};
        const Released gil;
        read(kernels, tree.tree, from[0], raster, points ? &stack : nullptr, wanted.data(), to, threads, check);
    };
    if (image.itemsize() == 8)
        call(std::complex<float>());
    else
        call(std::complex<double>());
}

template <typename T>
py::array_t<T> array(const std::vector<T>& values) {
    return py::array_t<T>(static_cast<py::ssize_t>(values.size()), values.data());
}

py::tuple group_subtree(const py::array& trace, const Array<double>& centres, const Array<std::int64_t>& order,
                        const Array<double>& medium, const std::vector<int>& fans, int taps, int half, double rate,
                        double plane, double direction, const Array<double>& readings, double step, std::int64_t left) {
    static_assert(sizeof(Point) == 3 * sizeof(double) && sizeof(Reading) == 4 * sizeof(double),
                  "rows of arrays are read as these structs");
    Geometry survey{records<Trace>(trace, "trace"), nullptr, trace.size(), {}, 0, 0};
    if (centres.size() != 3 * trace.size() || medium.size() != 4 || readings.ndim() != 2 || readings.shape(1) != 4 ||
        readings.shape(0) == 0)
        throw py::value_error("a group: rows of centres and readings");
    survey.model.c = medium.at(0);
    survey.model.fc = medium.at(1);
    survey.model.fs = medium.at(2);  // the bandwidth, whose half is the band
    survey.band = 0.5;
    survey.delay = medium.at(3);
    const auto* point = reinterpret_cast<const Point*>(centres.data());
    const std::vector<Point> places(point, point + trace.size());
    const auto* reading = reinterpret_cast<const Reading*>(readings.data());
    std::vector<Reading> reads(reading, reading + readings.shape(0));
    Layout layout{0, fans, {}, 1, 0, 0, 0};
    layout.taps.rate = rate;
    layout.taps.taps.count = taps;
    layout.taps.taps.half = half;
    Subtree made;
    FlatLevels flat;
    {
        const Released gil;
        const Group group = make_group(Numbers(order.data(), order.data() + order.size()), places);
        made = make_subtree(group, survey, places, layout, plane, direction, std::move(reads), step, left);
        flat = flatten(made.levels);
    }
    return py::make_tuple(array(made.traces), array(flat.count), array(flat.place), array(flat.shape),
                          array(flat.range), array(flat.span), made.along);
}

template <typename Real>
py::dict sizes_of() {
    using List = Sizes<Real>;
    const auto listed = [](const auto& list) {
        return py::tuple(py::cast(std::vector<int>(std::begin(list), std::end(list))));
    };
    return py::dict("degrees"_a = listed(List::degrees), "terms"_a = listed(List::terms), "nodes"_a = List::nodes);
}

py::dict kernel_sizes() {
    return py::dict("float32"_a = sizes_of<float>(), "float64"_a = sizes_of<double>(), "block"_a = block,
                    "step"_a = max_step, "rows"_a = tile_rows);
}

std::string isa_of(const std::string& name) { return kernels_for(name).name; }

void translate(std::exception_ptr pointer) {
    try {
        if (pointer) std::rethrow_exception(pointer);
    } catch (const Error& error) {
        if (error.code ==
            Code::cancelled)  // ticks stop sums at the interpreter's end alone: a thread ends without a word
            PyErr_SetNone(PyExc_SystemExit);
        else
            PyErr_SetString(error.code == Code::argument ? PyExc_ValueError : PyExc_RuntimeError, error.what());
    } catch (const std::length_error&) {
        PyErr_NoMemory();
    } catch (const std::logic_error& error) {
        PyErr_SetObject(py::module_::import("pysas._checks").attr("InternalError").ptr(), py::str(error.what()).ptr());
    }
}

}  // namespace

PYBIND11_MODULE(_core, m) {
    m.doc() = "Compiled part of the engine.";
    py::register_exception_translator(&translate);
    PYBIND11_NUMPY_DTYPE(Trace, tx, rx, velocity, boresight, t0, kept, interval);
    PYBIND11_NUMPY_DTYPE(Model, c, fc, fs, rate, last, cos_beam, near, run);
    m.def("compiler", &compiler, "Name and version of the compiler that built this extension.");
    m.def("levels", &levels, "Instruction sets this build has and this machine runs, worst first.");
    m.def("sizes", &kernel_sizes, "What kernels are compiled for, by type, and what all of them share.");
    m.def("isa", &isa_of, "name"_a, "The instruction set that `name` stands for.");
    m.def("stop_others", &leaving::stop_others, "The interpreter ends in this thread: sums in others are to stop.");
    m.def("keep_others", &leaving::keep_others, "From now on the other threads do not come back to it.");
    m.def("away", &leaving::away, "Threads outside the interpreter that may still come back.");
    m.def("plane_stride", &plane_stride, "intervals"_a, "degree"_a, "real"_a,
          "Reals from one plane of a table to the next.");
    m.def("intervals", &intervals_of, "length"_a, "rate"_a, "Intervals of a table over `length` samples.");
    m.def("design", &design_filter, "band"_a, "degree"_a, "phases"_a, "step"_a, "error"_a, "least"_a, "most"_a,
          "Filter weights (phase, tap, power), first taps and measured error.");
    m.def("peaks", &trace_peaks, "data"_a, "begin"_a, "end"_a, "threads"_a, "tick"_a,
          "Largest real or imaginary part of some samples of every trace; not finite where the trace is not.");
    m.def("mean_squares", &squares_about, "data"_a, "trace"_a, "place"_a, "reach"_a, "scale"_a, "threads"_a, "tick"_a,
          "Mean squares of samples about places.");
    m.def("prepare", &prepare_batch, "data"_a, "order"_a, "start"_a, "weights"_a, "scale"_a, "weight"_a, "first"_a,
          "step"_a, "length"_a, "table"_a, "threads"_a, "isa"_a, "tick"_a, "Fill the tables of a batch of traces.");
    py::class_<TreeOf>(m, "Tree", "Interpolation and carrier that all steps of a tree share.")
        .def(py::init<const Array<float>&, const Array<float>&, const Array<float>&, const Array<float>&, double,
                      const std::vector<double>&, const std::vector<double>&, const Array<double>&,
                      const Array<double>&>(),
             "even"_a, "odd"_a, "tap"_a, "filter"_a, "wave"_a, "sine"_a, "cosine"_a, "nodes"_a, "fit"_a);
    m.def("leaves", &fill_leaves, "tree"_a, "table"_a, "degree"_a, "sine"_a, "cosine"_a, "trace"_a, "model"_a, "kind"_a,
          "span"_a, "place"_a, "shape"_a, "range"_a, "weights"_a, "store"_a, "slack"_a, "smooth"_a, "threads"_a,
          "isa"_a, "tick"_a, "Fill the sub-images of groups of traces.");
    m.def("merge", &merge_sub_images, "tree"_a, "span"_a, "child_place"_a, "child_shape"_a, "child_range"_a,
          "child_store"_a, "place"_a, "shape"_a, "range"_a, "store"_a, "add"_a, "last"_a, "smooth"_a, "threads"_a,
          "isa"_a, "tick"_a, "Fill sub-images from their children's.");
    m.def("read", &read_sub_image, "tree"_a, "place"_a, "shape"_a, "range"_a, "store"_a, "first"_a, "step"_a,
          "points"_a, "axis"_a, "heights"_a, "number"_a, "mask"_a, "count"_a, "wanted"_a, "image"_a, "threads"_a,
          "isa"_a, "tick"_a, "Add a sub-image to an image's tiles.");
    m.def("subtree", &group_subtree, "trace"_a, "centres"_a, "order"_a, "medium"_a, "fans"_a, "taps"_a, "half"_a,
          "rate"_a, "plane"_a, "direction"_a, "readings"_a, "step"_a, "left"_a, "The tree below a group of traces.");
    m.def("add", &add_batch, "table"_a, "degree"_a, "sine"_a, "cosine"_a, "trace"_a, "model"_a, "kind"_a, "nodes"_a,
          "fit"_a, "first"_a, "step"_a, "points"_a, "mask"_a, "count"_a, "weights"_a, "own"_a, "image"_a, "threads"_a,
          "isa"_a, "tick"_a, "Add a batch's terms to an image; returns how many.");
    m.def("arcs", &view_arcs, "trace"_a, "channels"_a, "cos_beam"_a, "points"_a, "order"_a, "out"_a, "threads"_a,
          "tick"_a, "Arcs of view angle at points, and the pattern of the views at each.");
}
