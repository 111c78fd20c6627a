//! Fuzz targets of every decoder that faces hardware, as tests in `tests/`. `docs/bridges.md` says how to run them.
