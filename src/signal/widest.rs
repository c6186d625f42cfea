//! Kernels on the widest vectors that the processor has.
//!
//! What is built for every x86-64 adds two numbers at a time; most machines can do four. A kernel here is compiled for
//! both, and the choice is made when it is called. Results do not depend on it: the order of additions is that of the
//! source, and products are never fused into them.

/// Runs a kernel. What it calls must be inlined into it, or stays on narrow vectors: the kernel itself is to be
/// `#[inline(always)]`, and its innermost loops plain ones over indices or slices. The compiler leaves adapters of
/// arrays (`from_fn`, `fold` with an array) as functions of their own.
#[inline]
pub fn widest<R>(kernel: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(kernel)
}
