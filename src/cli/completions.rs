//! `completions` and `man`: what a shell and `man` want to know of the command line.

use super::{CliError, Outcome};
use clap::CommandFactory;
use std::path::PathBuf;

/// Print completions for a shell.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Shell to complete for.
    shell: clap_complete::Shell,
}

/// Write the manual pages.
#[derive(Debug, clap::Args)]
pub struct ManArgs {
    /// Folder to write them to; without it the main page is printed.
    #[arg(short, long)]
    output: Option<PathBuf>,
}

/// Prints completions.
///
/// # Errors
/// None; the signature is that of all subcommands.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    clap_complete::generate(args.shell, &mut super::Cli::command(), "shaketable", &mut std::io::stdout());
    Ok(Outcome::Done)
}

/// Writes the manual pages.
///
/// # Errors
/// A folder that cannot be written.
pub fn man(args: ManArgs) -> Result<Outcome, CliError> {
    let command = super::Cli::command();
    match args.output {
        Some(folder) => {
            std::fs::create_dir_all(&folder).map_err(CliError::failed)?;
            clap_mangen::generate_to(command, folder).map_err(CliError::failed)?;
        }
        None => clap_mangen::Man::new(command).render(&mut std::io::stdout()).map_err(CliError::failed)?,
    }
    Ok(Outcome::Done)
}
