// Work without the GIL, and what comes back to it now and then.
#pragma once

#include <pybind11/pybind11.h>

#include "core/leaving.hpp"
#include "core/threads.hpp"

namespace pysas {

namespace py = pybind11;

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
inline Tick ticker(const py::object& tick) {
    return [&tick](double share) {
        if (leaving::stopping()) return false;
        const py::gil_scoped_acquire gil;
        if (PyErr_CheckSignals() != 0) throw py::error_already_set();
        if (!tick.is_none()) tick(share);
        return true;
    };
}

}  // namespace pysas
