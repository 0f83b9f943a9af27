#include "bind/plans.hpp"

#include <pybind11/complex.h>
#include <pybind11/numpy.h>
#include <pybind11/stl.h>

#include <complex>
#include <memory>
#include <optional>
#include <string>
#include <tuple>
#include <utility>
#include <variant>
#include <vector>

#include "bind/arguments.hpp"
#include "bind/released.hpp"
#include "core/errors.hpp"
#include "planning/imaging.hpp"
#include "planning/planner.hpp"

namespace pysas {
namespace {

using py::operator""_a;

// A Python object that is held, and let go, without the GIL.
template <typename Object>
std::shared_ptr<Object> shared(Object object) {
    return {new Object(std::move(object)), [](Object* held) {
                const py::gil_scoped_acquire gil;
                delete held;
            }};
}

Survey make_survey(const py::array& trace, const Array<std::complex<double>>& weights, const py::array& model,
                   double band, bool single, std::int64_t channels, bool each) {
    Survey out;
    const Trace* first = records<Trace>(trace, "trace");
    out.traces.assign(first, first + trace.size());
    out.weights.assign(weights.data(), weights.data() + weights.size());
    if (out.weights.size() != out.traces.size() || channels < 1 || trace.size() % channels != 0)
        throw py::value_error("a survey: a weight for each trace, as many traces for each ping");
    out.model = *records<Model>(model, "model");
    out.band = band;
    out.single = single;
    out.channels = channels;
    out.each = each;
    return out;
}

void give_lattice(Survey& survey, const Array<float>& value, const Array<double>& axes, double vector, double beyond) {
    if (value.ndim() != 3 || value.shape(0) < 4 || value.shape(1) < 4 || axes.size() != 5 ||
        value.shape(2) != static_cast<py::ssize_t>(survey.traces.size()))
        throw py::value_error(
            "a lattice: (ny, nx, trace) of at least 4 x 4 places, its first place, steps, longest line");
    survey.bent = Bent{axes.at(4), vector, beyond};
    survey.keep = shared(py::object(value));
    survey.lattice = LatticeWeights{value.data(), value.shape(1), value.shape(0), axes.at(0),
                                    axes.at(1),   axes.at(2),     axes.at(3),     axes.at(4)};
}

// Of a list (n, 3), of the axes and heights of a map, or what a function tells by pixels' numbers.
using Places = std::variant<Array<double>, std::tuple<Array<double>, Array<double>, Array<double>>, py::function>;

Points points_of(Places given, std::int64_t height, std::int64_t width, const Point& origin) {
    if (const auto* list = std::get_if<Array<double>>(&given)) {
        if (list->size() != 3 * height * width) throw py::value_error("pixels: a list of points");
        return points_in_list(list->data(), origin, shared(py::object(*list)));
    }
    if (const auto* map = std::get_if<1>(&given)) {
        const auto& [x, y, z] = *map;
        if (x.size() != width || y.size() != height || z.size() != height * width)
            throw py::value_error("pixels: a height map over its axes");
        return points_on_map(x.data(), y.data(), z.data(), width, origin, shared(py::object(py::make_tuple(x, y, z))));
    }
    return [call = shared(std::get<py::function>(std::move(given)))](const Numbers& numbers, double* to) {
        if (leaving::stopping()) throw Error(Code::cancelled, "the interpreter ends");
        const py::gil_scoped_acquire gil;
        const auto count = static_cast<py::ssize_t>(numbers.size());
        const auto found = (*call)(py::array_t<std::int64_t>(count, numbers.data())).cast<Array<double>>();
        if (found.size() != 3 * count) throw py::value_error("pixels: coordinates of points");
        std::copy_n(found.data(), found.size(), to);
    };
}

// Lines that points happen to lie on; a single row is a list.
void lines_of(const Places& given, const Point& origin, Pixels& pixels) {
    const auto* list = std::get_if<Array<double>>(&given);
    if (list && list->size() == 3 * pixels.size() && pixels.height > 1) find_lines(list->data(), origin, pixels);
    const auto* map = std::get_if<1>(&given);
    if (!map) return;
    const auto& [x, y, z] = *map;
    if (x.size() == pixels.width && y.size() == pixels.height && z.size() == pixels.size())
        find_lines(x.data(), y.data(), z.data(), origin, pixels);
}

Pixels make_pixels(std::int64_t height, std::int64_t width, const Array<double>& origin,
                   const std::optional<Array<double>>& first, const std::optional<Array<double>>& step, double uneven,
                   Places points, const std::optional<Array<bool>>& mask,
                   const std::optional<Array<std::int64_t>>& hears) {
    Pixels out;
    out.height = height;
    out.width = width;
    out.uneven = uneven;
    if (first && step) {
        if (first->size() != 3 * height || step->size() != 3 * height) throw py::value_error("pixels: rows of lines");
        out.first.assign(first->data(), first->data() + first->size());
        out.step.assign(step->data(), step->data() + step->size());
    }
    if (origin.size() != 3) throw py::value_error("pixels: an origin");
    if (hears) {
        if (hears->size() != 2 * height || mask) throw py::value_error("pixels: first and last traces of all rows");
        out.hears.assign(hears->data(), hears->data() + hears->size());
    }
    if (out.first.empty() && !hears) lines_of(points, point(origin.data()), out);
    out.points = points_of(std::move(points), height, width, point(origin.data()));
    if (mask) {
        if (mask->size() != height * width) throw py::value_error("pixels: a mask of all");
        const bool* wanted = mask->data();
        out.mask.assign(wanted, wanted + mask->size());
    }
    return out;
}

// Takes over what survey and pixels hold.
std::shared_ptr<Scene> make_scene(Survey& survey, Pixels& pixels, const Array<double>& low, const Array<double>& high) {
    if (low.size() != 3 || high.size() != 3) throw py::value_error("a scene: corners of a box");
    if (!pixels.hear(static_cast<std::int64_t>(survey.traces.size())))
        throw py::value_error("a scene: rows that hear its traces");
    const Released gil;
    return std::make_shared<Scene>(std::move(survey), std::move(pixels), point(low.data()), point(high.data()));
}

// What a plan chose, as pysas.planning.settings.Choices has it.
py::dict choices_of(const Plan& plan) {
    const Settings& s = plan.settings;
    const py::dict errors(py::cast(s.errors));
    return py::dict("precision"_a = s.narrow ? "float32" : "float64", "degree"_a = s.filter.degree,
                    "oversampling"_a = s.oversampling, "n_fft"_a = s.n_fft, "n_fine"_a = 2 * s.n_fft,
                    "length"_a = s.length, "margin"_a = s.margin, "taper"_a = s.taper, "beta"_a = s.beta,
                    "block"_a = s.block, "near"_a = s.near, "trigonometry"_a = s.terms, "batch"_a = s.batch,
                    "delay"_a = words_of(plan.scene->kind), "errors"_a = errors, "run"_a = s.run,
                    "phases"_a = s.filter.phases, "step"_a = s.filter.step, "taps"_a = s.filter.taps,
                    "wide"_a = s.wide);
}

// A plan that has all that sums need.
class Planned {
  public:
    Planned(std::shared_ptr<Scene> scene, double tol, double budget, const std::string& method, bool fallback,
            bool leave, bool pay, int threads, const std::string& isa)
        : isa_(kernels_for(isa).name) {
        const Method by = method == "auto"   ? Method::automatic
                          : method == "ffbp" ? Method::ffbp
                                             : Method::backprojection;
        const Wish wish{tol, budget, by, fallback, leave, pay, threads, isa_};
        const py::none nobody;
        const Tick check = ticker(nobody);
        const Released gil;
        imaging_ = std::make_unique<Imaging>(pysas::plan(std::move(scene), wish, check));
    }
    const Plan& plan() const { return imaging_->plan(); }
    void follow(const Planned& before) { imaging_->follow(*before.imaging_); }
    std::string describe(const std::string& shape, std::int64_t more) const { return plan().describe(shape, more); }
    std::string other() const {
        const Released gil;
        return alternative(plan());
    }
    Done image(const py::array& data, const py::array& to, bool whole, const py::object& tick) const {
        const Tick check = ticker(tick);
        const auto call = [&](auto kind) {
            using Sample = decltype(kind);
            const auto from = view<const Sample, 3>(data);
            const auto into = view<Sample, 2>(to);
            const Scene& scene = *plan().scene;
            if (from.shape[0] * from.shape[1] != scene.traces() || from.shape[2] != scene.samples() ||
                into.shape[0] != scene.pixels.height || into.shape[1] != scene.pixels.width)
                throw py::value_error("an image: data and pixels of the planned shape");
            const Released gil;
            return (*imaging_)(from, into, whole, check);
        };
        return plan().scene->survey.single ? call(std::complex<float>()) : call(std::complex<double>());
    }

  private:
    const char* isa_;
    std::unique_ptr<Imaging> imaging_;
};

template <typename Class>
void tell(py::class_<Class>& bound, const Plan& (*of)(const Class&)) {
    bound.def_property_readonly("choices", [of](const Class& self) { return choices_of(of(self)); })
        .def_property_readonly(
            "share", [of](const Class& self) { return of(self).share(); }, "Of terms, through trees.")
        .def_property_readonly("trees", [of](const Class& self) { return of(self).trees ? of(self).trees->count : 0; })
        .def_property_readonly("why_direct", [of](const Class& self) { return of(self).why_direct; });
}

}  // namespace

void bind_plans(py::module_& m) {
    py::class_<Survey>(m, "Survey", "Traces about an image's centre, what they weigh and have in common.")
        .def(py::init(&make_survey), "trace"_a, "weights"_a, "model"_a, "band"_a, "single"_a, "channels"_a, "each"_a)
        .def("give_lattice", &give_lattice, "value"_a.noconvert(), "axes"_a, "vector"_a, "beyond"_a,
             "Weights that change from pixel to pixel.");
    py::class_<Pixels>(m, "Pixels", "Lines about the image's centre, or points, and the mask of those wanted.")
        .def(py::init(&make_pixels), "height"_a, "width"_a, "origin"_a, "first"_a, "step"_a, "uneven"_a, "points"_a,
             "mask"_a, "hears"_a = py::none());
    py::class_<Scene, std::shared_ptr<Scene>>(m, "Scene", "What a planner sees of a survey and pixels in a box.")
        .def(py::init(&make_scene), "survey"_a, "pixels"_a, "low"_a, "high"_a);
    py::class_<Done> done(m, "Done", "What became of some data, and the plan that was carried out.");
    tell<Done>(done, [](const Done& self) -> const Plan& { return self.by->plan; });
    done.def_property_readonly("prepare_seconds", [](const Done& self) { return self.totals.prepare_seconds; })
        .def_property_readonly("sum_seconds", [](const Done& self) { return self.totals.sum_seconds; })
        .def_property_readonly("terms", [](const Done& self) { return self.totals.terms; })
        .def_readonly("left_out", &Done::left_out, "Traces with samples that are not finite.")
        .def_readonly("used", &Done::used, "Traces summed.")
        .def_readonly("beside", &Done::beside, "Error that bright samples make beyond the plan's bounds.")
        .def_readonly("lost", &Done::lost, "Share of the image that its type does not hold.")
        .def_readonly("loudest", &Done::loudest, "Trace beside which others are lost in float32, or -1.");
    py::class_<Planned> planned(m, "Plan", "How to image data of a scene; called with data and an image.");
    tell<Planned>(planned, [](const Planned& self) -> const Plan& { return self.plan(); });
    planned
        .def(py::init<std::shared_ptr<Scene>, double, double, const std::string&, bool, bool, bool, int,
                      const std::string&>(),
             "scene"_a, "tol"_a, "budget"_a, "method"_a, "fallback"_a, "leave"_a, "pay"_a, "threads"_a, "isa"_a)
        .def_property_readonly("isa", [](const Planned& self) { return self.plan().wish.isa; })
        .def_property_readonly(
            "seconds", [](const Planned& self) { return self.plan().seconds; }, "On one thread.")
        .def_property_readonly("memory", [](const Planned& self) { return self.plan().memory(); })
        .def("describe", &Planned::describe, "shape"_a, "more"_a)
        .def("other", &Planned::other, "The method that is not used: its predicted time, or why it cannot be.")
        .def("follow", &Planned::follow, "before"_a, "Work in the memory that a plan before keeps.")
        .def("__call__", &Planned::image, "data"_a, "image"_a, "whole"_a, "tick"_a);
}

}  // namespace pysas
