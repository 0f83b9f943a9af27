"""What the C++ extension exports; a test compares this with the extension itself."""

def compiler() -> str:
    """Name and version of the compiler that built this extension."""

def isa() -> str:
    """Best instruction set this machine offers to the kernels: baseline, avx2 or avx512."""
