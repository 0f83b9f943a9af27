// The Python face of the C++ core: pysas.engine._core. Bindings only make views, call the core and turn errors into
// exceptions; pysas/engine/_core.pyi is the list of what stands here, and a test compares the two.

#include <pybind11/numpy.h>
#include <pybind11/pybind11.h>
#include <pybind11/stl.h>

#include <string>

#include "bind/arguments.hpp"
#include "bind/plans.hpp"
#include "bind/released.hpp"
#include "core/arcs.hpp"
#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/filters.hpp"
#include "core/leaving.hpp"

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

Filter design_filter(double band, int degree, int phases, int step, double error, int least, int most) {
    return design(band, degree, phases, step, error, least, most);
}

py::array_t<double> weights_of(const Filter& filter) {
    return py::array_t<double>({filter.phases, filter.taps, filter.degree + 1}, filter.weight.data());
}

py::array_t<std::int64_t> first_taps(const Filter& filter) {
    return py::array_t<std::int64_t>(static_cast<py::ssize_t>(filter.first.size()), filter.first.data());
}

py::array_t<std::uint64_t> view_arcs(const py::array& trace, int channels, const py::array& beam,
                                     const Array<double>& points, const Array<std::int64_t>& order,
                                     const py::array& out, int threads, const py::object& tick) {
    const Tick check = ticker(tick);
    if (points.ndim() != 2 || points.shape(1) != 3) throw py::value_error("arcs: rows of points");
    const Viewers viewers{records<Trace>(trace, "trace"), trace.size(), channels, *records<Beam>(beam, "beam")};
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

py::dict kernel_sizes() { return py::dict("block"_a = block, "rows"_a = tile_rows); }

std::string isa_of(const std::string& name) { return kernels_for(name).name; }

void translate(std::exception_ptr pointer) {
    try {
        if (pointer) std::rethrow_exception(pointer);
    } catch (const Error& error) {
        if (error.code ==
            Code::cancelled)  // ticks stop sums at the interpreter's end alone: a thread ends without a word
            PyErr_SetNone(PyExc_SystemExit);
        else
            PyErr_SetString(error.code == Code::internal ? PyExc_RuntimeError : PyExc_ValueError, error.what());
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
    PYBIND11_NUMPY_DTYPE(Trace, tx, rx, velocity, boresight, axis, t0, c, first, last, kept, interval);
    PYBIND11_NUMPY_DTYPE(Beam, shape, half_angle, full_angle);
    PYBIND11_NUMPY_DTYPE(Model, c, fc, fs, rate, last, beam, near, run);
    bind_plans(m);
    m.def("compiler", &compiler, "Name and version of the compiler that built this extension.");
    m.def("levels", &levels, "Instruction sets this build has and this machine runs, worst first.");
    m.def("sizes", &kernel_sizes, "Pixels of a block and lines of a tile at most.");
    m.def("isa", &isa_of, "name"_a, "The instruction set that `name` stands for.");
    m.def("stop_others", &leaving::stop_others, "The interpreter ends in this thread: sums in others are to stop.");
    m.def("keep_others", &leaving::keep_others, "From now on the other threads do not come back to it.");
    m.def("away", &leaving::away, "Threads outside the interpreter that may still come back.");
    py::class_<Filter>(m, "Filter", "Coefficients of polynomials from samples.")
        .def_property_readonly("weight", &weights_of, "(phase, tap, power).")
        .def_property_readonly("first", &first_taps, "First tap of each phase.")
        .def_readonly("step", &Filter::step)
        .def_readonly("error", &Filter::error)
        .def_readonly("degree", &Filter::degree)
        .def_readonly("taps", &Filter::taps)
        .def_readonly("phases", &Filter::phases)
        .def_property_readonly("rate", &Filter::rate, "Intervals per sample.");
    m.def("design", &design_filter, "band"_a, "degree"_a, "phases"_a, "step"_a, "error"_a, "least"_a, "most"_a,
          "A filter, with its measured error.");
    m.def("arcs", &view_arcs, "trace"_a, "channels"_a, "beam"_a, "points"_a, "order"_a, "out"_a, "threads"_a, "tick"_a,
          "Arcs of view angle at points, and the pattern of the views at each.");
}
