//! The `whirlstand` command; everything it does lives in the `whirlstand-launch` room.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirlstand_launch::main()
}
