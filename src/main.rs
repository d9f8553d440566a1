//! The `shaketable` binary: everything is in the library's [`shaketable::cli`].

use std::process::ExitCode;

fn main() -> ExitCode {
    shaketable::cli::main()
}
