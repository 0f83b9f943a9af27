/* pysas from MATLAB and Octave: a MEX function over the C library.
 *
 *     image = pysas_image(data, survey, x, y, z, tol)
 *
 * data     sample x channel x ping, complex, single or double: range-compressed base-band samples
 * survey   struct of fs, fc (Hz), c (m/s), t0 (s), tx (3 x ping, m), rx (3 x channel x ping, m) and, where receivers move,
 *          velocity (3 x channel x ping, m/s); bandwidth (Hz) where it is not fs/1.1
 * x, y, z  coordinates of the pixels, m: two vectors of even spacing, and the height
 * tol      relative error, such as 1e-3
 * image    numel(y) x numel(x), complex, single or double as the data
 *
 * Build it in the folder of this file. INCLUDE is what pysas.get_include() returns in Python, FOLDER is where the library lies
 * that pysas.get_library() names:
 *
 *     mex pysas_image.c -IINCLUDE -LFOLDER -lpysas                                MATLAB
 *     mkoctfile --mex pysas_image.c -IINCLUDE -LFOLDER -lpysas -Wl,-rpath,FOLDER  Octave
 *
 * FOLDER has to be where the system looks for libraries when MATLAB runs it: on PATH on Windows, on LD_LIBRARY_PATH on Linux.
 * Complex arrays are taken as two arrays, of real and imaginary parts: the older of MATLAB's interfaces (-R2017b), which is
 * what `mex` and Octave take unless told otherwise. */
#include <math.h>
#include <mex.h>
#include <pysas.h>

static void must(int code) {
    if (code) mexErrMsgIdAndTxt("pysas:image", "pysas: %s", pysas_strerror(code));
}

static double number(const mxArray* survey, const char* name, int needed) {
    const mxArray* field = mxGetField(survey, 0, name);
    if (!field && !needed) return 0.0;
    if (!field || !mxIsDouble(field) || mxGetNumberOfElements(field) != 1)
        mexErrMsgIdAndTxt("pysas:image", "survey.%s: expected a number", name);
    return mxGetScalar(field);
}

/* Places of `count` elements, or NULL where they may be missing and are. */
static const double* places(const mxArray* survey, const char* name, size_t count, int needed) {
    const mxArray* field = mxGetField(survey, 0, name);
    if (!field && !needed) return NULL;
    if (!field || !mxIsDouble(field) || mxIsComplex(field) || mxGetNumberOfElements(field) != 3 * count)
        mexErrMsgIdAndTxt("pysas:image", "survey.%s: expected 3 x %d real doubles", name, (int)count);
    return mxGetPr(field);
}

/* The step of an even axis. */
static double step(const mxArray* axis, const char* name) {
    size_t count = mxGetNumberOfElements(axis);
    if (!mxIsDouble(axis) || mxIsComplex(axis) || count < 2)
        mexErrMsgIdAndTxt("pysas:image", "%s: expected a vector of two or more real doubles", name);
    const double* values = mxGetPr(axis);
    double found = (values[count - 1] - values[0]) / (double)(count - 1);
    for (size_t i = 0; i < count; ++i)
        if (!(fabs(values[i] - values[0] - found * (double)i) <= 1e-6 * fabs(found)))
            mexErrMsgIdAndTxt("pysas:image", "%s: expected even spacing", name);
    return found;
}

/* One array of pairs of what MATLAB holds as two arrays; MATLAB frees it. */
static void* pairs(const mxArray* data, size_t count) {
    const void *real = mxGetData(data), *imaginary = mxGetImagData(data);
    if (mxIsSingle(data)) {
        float* all = mxMalloc(2 * count * sizeof *all);
        for (size_t i = 0; i < count; ++i) all[2 * i] = ((const float*)real)[i], all[2 * i + 1] = ((const float*)imaginary)[i];
        return all;
    }
    double* all = mxMalloc(2 * count * sizeof *all);
    for (size_t i = 0; i < count; ++i) all[2 * i] = ((const double*)real)[i], all[2 * i + 1] = ((const double*)imaginary)[i];
    return all;
}

void mexFunction(int n_out, mxArray* out[], int n_in, const mxArray* in[]) {
    if (n_in != 6 || n_out > 1) mexErrMsgIdAndTxt("pysas:image", "expected image = pysas_image(data, survey, x, y, z, tol)");
    const mxArray *data = in[0], *given = in[1];
    if (!mxIsComplex(data) || (!mxIsSingle(data) && !mxIsDouble(data)) || mxGetNumberOfDimensions(data) > 3)
        mexErrMsgIdAndTxt("pysas:image", "data: expected sample x channel x ping, complex, single or double");
    if (!mxIsStruct(given)) mexErrMsgIdAndTxt("pysas:image", "survey: expected a struct");
    const mwSize* size = mxGetDimensions(data);

    pysas_survey survey = {sizeof survey};
    survey.n_sample = (int64_t)size[0];
    survey.n_channel = (int64_t)size[1];
    survey.n_ping = mxGetNumberOfDimensions(data) == 3 ? (int64_t)size[2] : 1; /* MATLAB drops a last axis of 1 */
    size_t traces = (size_t)(survey.n_ping * survey.n_channel);
    survey.fs = number(given, "fs", 1);
    survey.fc = number(given, "fc", 1);
    survey.c = number(given, "c", 1);
    survey.t0 = number(given, "t0", 1);
    survey.bandwidth = number(given, "bandwidth", 0);
    survey.tx = places(given, "tx", (size_t)survey.n_ping, 1);
    survey.rx = places(given, "rx", traces, 1);
    survey.velocity = places(given, "velocity", traces, 0);

    pysas_grid grid = {sizeof grid};
    grid.along[0] = step(in[2], "x");
    grid.down[1] = step(in[3], "y");
    grid.first[0] = mxGetPr(in[2])[0];
    grid.first[1] = mxGetPr(in[3])[0];
    grid.first[2] = mxGetScalar(in[4]);
    grid.width = (int64_t)mxGetNumberOfElements(in[2]);
    grid.height = (int64_t)mxGetNumberOfElements(in[3]);

    pysas_options options = {sizeof options};
    options.tol = mxGetScalar(in[5]);
    options.dtype = mxIsSingle(data) ? PYSAS_COMPLEX64 : PYSAS_COMPLEX128;
    options.method = PYSAS_AUTO;
    size_t pixels = (size_t)(grid.width * grid.height);
    void* samples = pairs(data, traces * (size_t)survey.n_sample);
    void* image = mxMalloc(pixels * (mxIsSingle(data) ? 2 * sizeof(float) : 2 * sizeof(double)));
    pysas_plan* plan;
    must(pysas_plan_create(&survey, &grid, &options, &plan));
    int64_t columns_first[2] = {1, grid.height}; /* MATLAB's order of the pixels */
    int code = pysas_plan_execute(plan, samples, NULL, image, columns_first);
    pysas_plan_destroy(plan);
    must(code);

    out[0] = mxCreateNumericMatrix((mwSize)grid.height, (mwSize)grid.width, mxGetClassID(data), mxCOMPLEX);
    void *real = mxGetData(out[0]), *imaginary = mxGetImagData(out[0]);
    for (size_t i = 0; i < pixels; ++i) {
        if (mxIsSingle(data)) {
            ((float*)real)[i] = ((float*)image)[2 * i];
            ((float*)imaginary)[i] = ((float*)image)[2 * i + 1];
        } else {
            ((double*)real)[i] = ((double*)image)[2 * i];
            ((double*)imaginary)[i] = ((double*)image)[2 * i + 1];
        }
    }
    mxFree(image);
    mxFree(samples);
}
