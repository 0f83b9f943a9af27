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

#include "bind/arguments.hpp"
#include "core/arcs.hpp"
#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/factorised.hpp"
#include "core/filters.hpp"
#include "core/leaving.hpp"
#include "core/summation.hpp"
#include "planning/subapertures.hpp"

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

Filter design_filter(double band, int degree, int phases, int step, double error, int least, int most) {
    return design(band, degree, phases, step, error, least, most, false);
}

py::array_t<double> weights_of(const Filter& filter) {
    return py::array_t<double>({filter.phases, filter.taps, filter.degree + 1}, filter.weight.data());
}

py::array_t<std::int64_t> first_taps(const Filter& filter) {
    return py::array_t<std::int64_t>(static_cast<py::ssize_t>(filter.first.size()), filter.first.data());
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
                   const std::optional<py::array_t<std::complex<double>>>& weights, double scale, const Filter& filter,
                   std::int64_t length, const py::array& table, int threads, const std::string& isa,
                   const py::object& tick) {
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

std::int64_t add_batch(const py::array& table, const Polynomials& by, const Traces& traces, const RasterArrays& raster,
                       const std::optional<py::array>& own, const py::array& image, int threads, const std::string& isa,
                       const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const auto call = [&](auto real, auto pixel) {
        using Real = decltype(real);
        Terms<Real> terms = terms_of<Real>(table, by, traces);
        const auto to = view<decltype(pixel), 2>(image);
        if (own) {
            const auto each = view<const Real, 2>(*own);
            const std::int64_t count = raster.count;
            if (!raster.points || each.shape[0] < (to.shape[1] + count - 1) / count * count ||
                each.shape[1] != terms.n_trace || each.stride[0] != terms.n_trace || each.stride[1] != 1)
                throw py::value_error("own weights: (point, trace) of whole blocks of points");
            terms.weights = each.data;
        }
        const Raster pixels = raster.of(to.shape[0], to.shape[1]);
        const Released gil;
        return add(kernels, terms, pixels, to, threads, check);
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

void fill_leaves(const TreeOf& tree, const Array<float>& table, const Polynomials& by, const Traces& traces,
                 const Array<std::int64_t>& span, const SubImageArrays& to, double slack, bool smooth, int threads,
                 const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const Terms<float> terms = terms_of<float>(table, by, traces);
    const std::int64_t* spans = span.data();
    const Released gil;
    leaves(kernels, tree.tree, terms, spans, to.images.data(), static_cast<std::int64_t>(to.images.size()), slack,
           smooth, threads, check);
}

void merge_sub_images(const TreeOf& tree, const Array<std::int64_t>& span, const SubImageArrays& children,
                      const SubImageArrays& to, bool add, bool last, bool smooth, int threads, const std::string& isa,
                      const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    const std::int64_t* spans = span.data();
    const Released gil;
    merge(kernels, tree.tree, children.images.data(), spans, to.images.data(),
          static_cast<std::int64_t>(to.images.size()), add, last, smooth, threads, check);
}

void read_sub_image(const TreeOf& tree, const SubImageArrays& from, const RasterArrays& raster,
                    const std::optional<Stack>& stack, const Array<std::uint8_t>& wanted, const py::array& image,
                    int threads, const std::string& isa, const py::object& tick) {
    const Kernels& kernels = kernels_for(isa);
    const Tick check = ticker(tick);
    if (raster.points.has_value() != stack.has_value()) throw py::value_error("points are read from a stack");
    const auto call = [&](auto pixel) {
        const auto to = view<decltype(pixel), 2>(image);
        const Raster pixels = raster.of(to.shape[0], to.shape[1]);
        const Stack* planes = stack ? &*stack : nullptr;
        const Released gil;
        read(kernels, tree.tree, from.images[0], pixels, planes, wanted.data(), to, threads, check);
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
    m.def("peaks", &trace_peaks, "data"_a, "begin"_a, "end"_a, "threads"_a, "tick"_a,
          "Largest real or imaginary part of some samples of every trace; not finite where the trace is not.");
    m.def("mean_squares", &squares_about, "data"_a, "trace"_a, "place"_a, "reach"_a, "scale"_a, "threads"_a, "tick"_a,
          "Mean squares of samples about places.");
    py::class_<Filter>(m, "Filter", "Coefficients of polynomials from samples.")
        .def(py::init(&make_filter), "weight"_a, "first"_a, "step"_a, "error"_a)
        .def_property_readonly("weight", &weights_of, "(phase, tap, power).")
        .def_property_readonly("first", &first_taps, "First tap of each phase.")
        .def_readonly("step", &Filter::step)
        .def_readonly("error", &Filter::error)
        .def_readonly("degree", &Filter::degree)
        .def_readonly("taps", &Filter::taps)
        .def_readonly("phases", &Filter::phases)
        .def_property_readonly("rate", &Filter::rate, "Intervals per sample.");
    py::class_<Polynomials>(m, "Polynomials", "How tables are read and delays formed.")
        .def(py::init<int, std::vector<double>, std::vector<double>, const Array<double>&, const Array<double>&>(),
             "degree"_a, "sine"_a, "cosine"_a, "nodes"_a, "fit"_a);
    py::class_<Traces>(m, "Traces", "Traces, what they have in common, their weights on a lattice.")
        .def(py::init<py::array, py::array, int, LatticeArrays>(), "trace"_a, "model"_a, "kind"_a, "weights"_a);
    py::class_<RasterArrays>(m, "Raster", "Lines, or points, in blocks of `count`.")
        .def(py::init<std::optional<Array<double>>, std::optional<Array<double>>, std::optional<Array<double>>,
                      std::optional<Array<bool>>, int>(),
             "first"_a, "step"_a, "points"_a, "mask"_a, "count"_a);
    py::class_<SubImageArrays>(m, "SubImages", "Sub-images of one level.")
        .def(py::init<Array<double>, Array<std::int64_t>, Array<std::int32_t>, Array<float>>(), "place"_a, "shape"_a,
             "range"_a, "store"_a);
    py::class_<Stack>(m, "Stack", "Planes that pixels between them are read from.")
        .def(py::init(&make_stack), "axis"_a, "heights"_a, "number"_a);
    py::class_<TreeOf>(m, "Tree", "Interpolation and carrier that all steps of a tree share.")
        .def(py::init<const Array<float>&, const Array<float>&, const Array<float>&, const Array<float>&, double,
                      const Polynomials&>(),
             "even"_a, "odd"_a, "tap"_a, "filter"_a, "wave"_a, "carrier"_a);
    m.def("design", &design_filter, "band"_a, "degree"_a, "phases"_a, "step"_a, "error"_a, "least"_a, "most"_a,
          "A filter, with its measured error.");
    m.def("prepare", &prepare_batch, "data"_a, "order"_a, "start"_a, "weights"_a, "scale"_a, "filter"_a, "length"_a,
          "table"_a, "threads"_a, "isa"_a, "tick"_a, "Fill the tables of a batch of traces.");
    m.def("leaves", &fill_leaves, "tree"_a, "table"_a, "polynomials"_a, "traces"_a, "span"_a, "to"_a, "slack"_a,
          "smooth"_a, "threads"_a, "isa"_a, "tick"_a, "Fill the sub-images of groups of traces.");
    m.def("merge", &merge_sub_images, "tree"_a, "span"_a, "children"_a, "to"_a, "add"_a, "last"_a, "smooth"_a,
          "threads"_a, "isa"_a, "tick"_a, "Fill sub-images from their children's.");
    m.def("read", &read_sub_image, "tree"_a, "sub_image"_a, "raster"_a, "stack"_a, "wanted"_a, "image"_a, "threads"_a,
          "isa"_a, "tick"_a, "Add a sub-image to an image's tiles.");
    m.def("subtree", &group_subtree, "trace"_a, "centres"_a, "order"_a, "medium"_a, "fans"_a, "taps"_a, "half"_a,
          "rate"_a, "plane"_a, "direction"_a, "readings"_a, "step"_a, "left"_a, "The tree below a group of traces.");
    m.def("add", &add_batch, "table"_a, "polynomials"_a, "traces"_a, "raster"_a, "own"_a, "image"_a, "threads"_a,
          "isa"_a, "tick"_a, "Add a batch's terms to an image; returns how many.");
    m.def("arcs", &view_arcs, "trace"_a, "channels"_a, "cos_beam"_a, "points"_a, "order"_a, "out"_a, "threads"_a,
          "tick"_a, "Arcs of view angle at points, and the pattern of the views at each.");
}
