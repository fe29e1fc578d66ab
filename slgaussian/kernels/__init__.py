"""Support for compiled kernels: compilation, SIMD, thread pools and seeds."""
