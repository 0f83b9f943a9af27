/* pysas from C: synthetic aperture sonar images by back-projection, direct or fast factorised, with a relative error
 * that the caller states.
 *
 * Every function returns 0 or one of the codes below; none throws, exits or prints. Structs begin with their size, so
 * that a library newer than its caller knows which fields the caller has: set struct_size = sizeof(the struct) and zero
 * the rest. Lengths are in metres, times in seconds, frequencies in hertz. Strides count elements, not bytes. Arrays
 * without strides are C-contiguous. Numbers of structs are finite and at most 1e15. A plan may be executed from several
 * threads at a time.
 *
 * The image is the sum over pings and channels of s(tau) exp(+2 pi i fc tau), where tau is a pixel's two-way travel
 * time and s the band-limited signal that the range-compressed base-band samples stand for; a term counts where 0 <=
 * (tau - t0) fs <= n_sample - 1 and, with a beam, where the angle off its middle is at most the half-angle; rounding
 * does not decide: 1e-4 samples beyond a record's end (the trace is read at the end) and 1e-7 rad beyond the half-angle
 * of a beam without taper, or beyond the end of a fan's side, still count; so does a pixel on a transmitter. It is
 * wrong by at most tol max(|image|, |level|) in the 2-norm over the pixels, where level^2 is the sum of the terms'
 * squares. Samples that no pixel reads may be far brighter than those that pixels do: they are looked at when data
 * arrive, and where they are so bright that no sum in double keeps tol, the call says so.
 */
#ifndef PYSAS_H
#define PYSAS_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32)
#if defined(PYSAS_BUILD)
#define PYSAS_API __declspec(dllexport)
#else
#define PYSAS_API __declspec(dllimport)
#endif
#else
#define PYSAS_API __attribute__((visibility("default")))
#endif

#ifdef __cplusplus
extern "C" {
#endif

enum {
    PYSAS_OK = 0,
    PYSAS_ERROR_ARGUMENT = 1,  /* a null pointer, a size, rate or coordinate that is not allowed or not finite */
    PYSAS_ERROR_TOLERANCE = 2, /* tol cannot be kept: see pysas_options; from pysas_plan_execute: beside samples that
                                * are too bright, the image was made all the same */
    PYSAS_ERROR_MEMORY = 3,
    PYSAS_ERROR_CANCELLED = 4, /* progress returned something other than 0 */
    PYSAS_ERROR_INTERNAL = 5,  /* a fault of pysas, not of its input: please report it */
    PYSAS_ERROR_STRUCT = 6,    /* struct_size is not one this library knows */
    PYSAS_ERROR_DATA = 7,      /* samples that are not finite */
    PYSAS_ERROR_RANGE = 8 /* the image, or a weight times a sample, lies beyond the range of its type, or all but one
                           * trace is lost beside that in sums of floats */
};

enum { PYSAS_COMPLEX64 = 0, PYSAS_COMPLEX128 = 1 };

enum {
    PYSAS_BACKPROJECTION = 0, /* every term of the sum by itself */
    PYSAS_FFBP = 1,           /* through trees of sub-apertures (fast factorised back-projection), within the same tol:
                               * faster for large images, not for small ones. Summed directly: pixels near the track or
                               * across the ends of records or beams; all with tol below 3e-5, and all
                               * where trees would take longer */
    PYSAS_AUTO = 2            /* whichever has the least predicted time for one image, planning included */
};

enum {
    PYSAS_BEAM_CONE = 0, /* the angle of a pixel is that off boresight */
    PYSAS_BEAM_FAN = 1   /* ... off the plane across beam_axis, of which only boresight's side is lit */
};

typedef struct pysas_survey {
    size_t struct_size;
    int64_t n_ping, n_channel, n_sample;
    double fs;               /* sample rate */
    double fc;               /* demodulation frequency, > 0 */
    double bandwidth;        /* two-sided, of the samples; at most fs / 1.1; 0: fs / 1.1 */
    double c;                /* speed of sound */
    double t0;               /* time of sample 0 after the start of transmission */
    const double* ping_t0;   /* (n_ping), or NULL: t0 for all */
    const double* tx;        /* (n_ping, 3) transmitters */
    const double* rx;        /* (n_ping, n_channel, 3) receivers when the ping starts */
    const double* velocity;  /* (n_ping, n_channel, 3) receivers' velocities, below c / 2, or NULL: none */
    const double* weights;   /* (n_ping, n_channel) factors of the terms, or NULL: 1 */
    const double* boresight; /* (n_ping, 3) directions of any length but 0, or NULL: no beam */
    double beam_half_angle;  /* terms outside it do not count, radians in (0, pi], of a fan in (0, pi/2]; not read
                              * without boresight */
    int32_t beam_shape;      /* PYSAS_BEAM_CONE, also for callers whose struct ends above, or PYSAS_BEAM_FAN */
    double beam_taper; /* share of the half-angle over which a term's weight falls from 1 to 0 as cos^2, 0 to 1; if
                        * not 0, at least 1e-5 radians of it */
    const double* beam_axis; /* (n_ping, 3) directions along a fan's element, of any length but 0, or NULL: boresight x
                              * vertical (z) */
    const double* ping_c; /* (n_ping) speeds of sound, or NULL, also for callers whose struct ends above: c for all */
    const int64_t* valid; /* (n_ping, n_channel, 2) first and last sample that were recorded, the last one less than
                           * the first where none was, or NULL: all. Others count for nothing, whatever they hold */
} pysas_survey;

typedef struct pysas_grid {
    size_t struct_size;
    int64_t height, width;
    double first[3], along[3], down[3]; /* pixel (i, j) = first + j along + i down */
    const double* points;               /* (height, width, 3) instead of the above, or NULL */
    const uint8_t* mask;                /* (height, width) 0: pixel not wanted, left zero; or NULL */
} pysas_grid;

typedef struct pysas_options {
    size_t struct_size;
    double tol;      /* 1e-1 to 1e-5 (complex64), to 1e-10 (complex128) */
    int32_t dtype;   /* of samples and image: PYSAS_COMPLEX64 or PYSAS_COMPLEX128 */
    int32_t threads; /* 0: all processors. The image does not depend on it */
    const char* isa; /* "baseline", "avx2", "avx512", "neon", or NULL: PYSAS_ISA of the environment, else the best */
    int (*progress)(double share,
                    void* user); /* called now and then from the calling thread; not 0 stops. May be NULL */
    void* user;
    int32_t method; /* PYSAS_BACKPROJECTION, also for callers whose struct ends above, PYSAS_FFBP or PYSAS_AUTO */
} pysas_options;

typedef struct pysas_plan pysas_plan;

/* Choose how to image data of a geometry; nothing of the arguments is kept. */
PYSAS_API int pysas_plan_create(const pysas_survey* survey, const pysas_grid* grid, const pysas_options* options,
                                pysas_plan** plan);

/* Image data (ping, channel, sample) into image (row, column), which is overwritten: its pixels have memory of their
 * own, none of it between the first and the last of the data. Strides may be NULL: C-contiguous. */
PYSAS_API int pysas_plan_execute(const pysas_plan* plan, const void* data, const int64_t data_stride[3], void* image,
                                 const int64_t image_stride[2]);

/* Share of the terms that go through trees: 0 of a direct sum, and of a null plan. */
PYSAS_API double pysas_plan_factorised_share(const pysas_plan* plan);

/* What is predicted of an image: seconds on the plan's threads, by constants of the library, and a bound of its
 * relative error. 0 of a null plan. */
PYSAS_API double pysas_plan_seconds(const pysas_plan* plan);
PYSAS_API double pysas_plan_error(const pysas_plan* plan);

/* The plan in words, lines of text: at most `size` characters of it, the last of them 0, go to `text`, which may be
 * NULL with size 0. Returns how many characters there are, without the 0. */
PYSAS_API size_t pysas_plan_describe(const pysas_plan* plan, char* text, size_t size);

PYSAS_API void pysas_plan_destroy(pysas_plan* plan);

PYSAS_API const char* pysas_strerror(int code);

#ifdef __cplusplus
}
#endif
#endif
