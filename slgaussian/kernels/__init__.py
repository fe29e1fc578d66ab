"""What kernels share: vector code, thread pools, seeds, and the message while they compile."""
