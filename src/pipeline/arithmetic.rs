//! CPUs on which a table has the same bytes.
//!
//! Linear algebra, transforms and the C library choose their instructions by the CPU. With AVX2 and FMA (every x86-64
//! processor of servers and desktops since 2013 or 2015) all choose the same, and AVX-512 is not used. A CPU without
//! them rounds differently in the last digits. Therefore the kind of CPU enters each computed table's recipe: tables of
//! two kinds are never confused, and `plan` says why one is computed again. docs/reliability.md reports how much they
//! differ (`tests/other_cpus.sh`).

/// Kind of every table that is copied from raw files, or from a table made elsewhere.
pub const COPIED: &str = "any";

/// Kind of this machine's CPU.
#[must_use]
pub fn of_this_cpu() -> &'static str {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
        return "x86_64 with avx2 and fma";
    }
    std::env::consts::ARCH
}
