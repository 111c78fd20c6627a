//! How long a step takes: `cargo bench -p whirlstand-vehicle`.
fn main() {}
