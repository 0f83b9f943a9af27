/* Images a file of raw floats: cc image.c -I"$(include)" "$(library)" -o image, where the two paths are those that
 * pysas.get_include() and pysas.get_library() return.
 *
 *     image IN OUT n_ping n_channel n_sample fs fc c t0 nx ny x0 y0 step
 *
 * IN holds, as little-endian float32 or float64 in this order: samples (ping, channel, sample) as float pairs, transmitters
 * (ping, 3) and receivers (ping, channel, 3) as doubles. OUT gets (ny, nx) float pairs. */
#include <pysas.h>
#include <stdio.h>
#include <stdlib.h>

static void* read_all(FILE* file, size_t count, size_t size) {
    void* values = malloc(count * size);
    if (!values || fread(values, size, count, file) != count) {
        fprintf(stderr, "the file is too short, or there is too little memory\n");
        exit(1);
    }
    return values;
}

static void must(int code) {
    if (code) {
        fprintf(stderr, "pysas: %s\n", pysas_strerror(code));
        exit(1);
    }
}

int main(int argc, char** argv) {
    if (argc != 15) {
        fprintf(stderr, "usage: image IN OUT n_ping n_channel n_sample fs fc c t0 nx ny x0 y0 step\n");
        return 2;
    }
    FILE* in = fopen(argv[1], "rb");
    if (!in) {
        perror(argv[1]);
        return 1;
    }
    pysas_survey survey = {sizeof survey};
    survey.n_ping = atoll(argv[3]);
    survey.n_channel = atoll(argv[4]);
    survey.n_sample = atoll(argv[5]);
    survey.fs = atof(argv[6]);
    survey.fc = atof(argv[7]);
    survey.c = atof(argv[8]);
    survey.t0 = atof(argv[9]);
    size_t traces = (size_t)(survey.n_ping * survey.n_channel);
    float* data = read_all(in, traces * (size_t)survey.n_sample * 2, sizeof(float));
    survey.tx = read_all(in, (size_t)survey.n_ping * 3, sizeof(double));
    survey.rx = read_all(in, traces * 3, sizeof(double));
    fclose(in);

    pysas_grid grid = {sizeof grid};
    grid.width = atoll(argv[10]);
    grid.height = atoll(argv[11]);
    grid.first[0] = atof(argv[12]);
    grid.first[1] = atof(argv[13]);
    grid.along[0] = grid.down[1] = atof(argv[14]);

    pysas_options options = {sizeof options};
    options.tol = 1e-3;
    options.dtype = PYSAS_COMPLEX64;
    pysas_plan* plan;
    must(pysas_plan_create(&survey, &grid, &options, &plan));
    size_t pixels = (size_t)(grid.width * grid.height);
    float* image = malloc(pixels * 2 * sizeof(float));
    must(image ? pysas_plan_execute(plan, data, NULL, image, NULL) : PYSAS_ERROR_MEMORY);
    pysas_plan_destroy(plan);

    FILE* out = fopen(argv[2], "wb");
    if (!out || fwrite(image, sizeof(float), 2 * pixels, out) != 2 * pixels || fclose(out)) {
        perror(argv[2]);
        return 1;
    }
    return 0;
}
