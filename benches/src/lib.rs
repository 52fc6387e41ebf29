//! Benchmarks of stillflux live in `benches/`.
