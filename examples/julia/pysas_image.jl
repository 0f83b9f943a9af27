# pysas from Julia by ccall: the structs of pysas.h, field by field, and one image. Not run by the project's tests, for want of a
# Julia there: a test compares the structs with pysas.h. LIBRARY is what pysas.get_library() returns in Python.

const LIBRARY = ENV["PYSAS_LIBRARY"]

Base.@kwdef struct Survey
    struct_size::Csize_t = 0
    n_ping::Int64
    n_channel::Int64
    n_sample::Int64
    fs::Float64
    fc::Float64
    bandwidth::Float64 = 0.0
    c::Float64
    t0::Float64
    ping_t0::Ptr{Float64} = C_NULL
    tx::Ptr{Float64}
    rx::Ptr{Float64}
    velocity::Ptr{Float64} = C_NULL
    weights::Ptr{Float64} = C_NULL
    boresight::Ptr{Float64} = C_NULL
    beam_half_angle::Float64 = 0.0
    beam_shape::Int32 = 0
    beam_taper::Float64 = 0.0
    beam_axis::Ptr{Float64} = C_NULL
    ping_c::Ptr{Float64} = C_NULL
    valid::Ptr{Int64} = C_NULL
end

Base.@kwdef struct Grid
    struct_size::Csize_t = 0
    height::Int64
    width::Int64
    first::NTuple{3,Float64}
    along::NTuple{3,Float64}
    down::NTuple{3,Float64}
    points::Ptr{Float64} = C_NULL
    mask::Ptr{UInt8} = C_NULL
end

Base.@kwdef struct Options
    struct_size::Csize_t = 0
    tol::Float64
    dtype::Int32 = 0                # complex64
    threads::Int32 = 0              # all processors
    isa::Cstring = C_NULL
    progress::Ptr{Cvoid} = C_NULL
    user::Ptr{Cvoid} = C_NULL
    method::Int32 = 2               # whichever is faster
end

function must(code)
    code == 0 || error(unsafe_string(ccall((:pysas_strerror, LIBRARY), Cstring, (Cint,), code)))
end

"""
    pysas_image(data, tx, rx, x, y, z; fs, fc, c, t0, tol = 1e-3)

Image (length(x), length(y)) of `data` (sample, channel, ping), ComplexF32, with `tx` (3, ping) and `rx` (3, channel, ping) in
metres, on ranges `x` and `y` at height `z`.
"""
function pysas_image(data::Array{ComplexF32,3}, tx::Matrix{Float64}, rx::Array{Float64,3}, x::AbstractRange, y::AbstractRange, z;
                     fs, fc, c, t0, tol = 1e-3)
    samples, channels, pings = size(data)
    size(tx) == (3, pings) && size(rx) == (3, channels, pings) || error("tx, rx: expected (3, ping) and (3, channel, ping)")
    image = Matrix{ComplexF32}(undef, length(x), length(y))
    plan = Ref{Ptr{Cvoid}}(C_NULL)
    GC.@preserve tx rx begin
        survey = Ref(Survey(; struct_size = sizeof(Survey), n_ping = pings, n_channel = channels, n_sample = samples,
                            fs, fc, c, t0, tx = pointer(tx), rx = pointer(rx)))
        grid = Ref(Grid(; struct_size = sizeof(Grid), height = length(y), width = length(x),
                        first = (Float64(first(x)), Float64(first(y)), Float64(z)),
                        along = (Float64(step(x)), 0.0, 0.0), down = (0.0, Float64(step(y)), 0.0)))
        options = Ref(Options(; struct_size = sizeof(Options), tol))
        must(ccall((:pysas_plan_create, LIBRARY), Cint, (Ref{Survey}, Ref{Grid}, Ref{Options}, Ref{Ptr{Cvoid}}),
                   survey, grid, options, plan))
    end
    code = ccall((:pysas_plan_execute, LIBRARY), Cint, (Ptr{Cvoid}, Ptr{ComplexF32}, Ptr{Int64}, Ptr{ComplexF32}, Ptr{Int64}),
                 plan[], data, C_NULL, image, C_NULL)
    ccall((:pysas_plan_destroy, LIBRARY), Cvoid, (Ptr{Cvoid},), plan[])
    must(code)
    return image
end
