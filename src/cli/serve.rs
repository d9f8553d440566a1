//! `serve`: the daemon with its page.

use super::reading::read_model;
use super::{CliError, Outcome};
use crate::config::builtin::find;
use crate::config::{Case, ConfigError};
use crate::control::session::Pace;
use crate::control::setup::model_of_case;
use crate::daemon::desk::{Desk, Options};
use crate::daemon::publish::PublishSpec;
use crate::daemon::work::Work;
use crate::daemon::{DaemonError, Listen, serve};
use crate::rig::RigSpec;
use crate::safety::SafetySpec;
use crate::sweep::SweepSpec;
use std::net::SocketAddr;
use std::path::PathBuf;
use tokio::signal::unix::{SignalKind, signal};

/// Start the daemon with its page.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Address to listen on; anything but loopback needs --token-file. Port 0 takes a free one.
    #[arg(long, default_value = "127.0.0.1:8732")]
    listen: SocketAddr,
    /// File with a token for viewers, operators and configurers; made on first use, mode 0600.
    #[arg(long)]
    token_file: Option<PathBuf>,
    /// A name by which clients reach the daemon, beside its address; may be repeated.
    #[arg(long = "host")]
    hosts: Vec<String>,
    /// Certificate chain, PEM: serve over TLS.
    #[arg(long, requires = "tls_key")]
    tls_certificate: Option<PathBuf>,
    /// Key of the certificate, PEM.
    #[arg(long, requires = "tls_certificate")]
    tls_key: Option<PathBuf>,
    /// Folder of the page's files, in place of the built-in ones: for work on the page.
    #[arg(long)]
    page: Option<PathBuf>,
    /// Publish live data, steps, events and status through a NATS server: a publication file, by name (local) or path.
    #[arg(long)]
    publish: Option<String>,
    /// Name of this table in what it publishes, in place of the file's.
    #[arg(long, requires = "publish")]
    table: Option<String>,
    /// Rig, by name or file.
    #[arg(long, default_value = "simulated")]
    rig: String,
    /// Sweep to begin with, by name or file.
    #[arg(long, default_value = "andreaus-2020")]
    sweep: String,
    /// Case of the paper to begin with.
    #[arg(long, default_value = "B1-G2-0.05")]
    case: Case,
    /// Onboard model to begin with, by name or file; without it that of the case.
    #[arg(long)]
    model: Option<String>,
    /// What really stands on the simulated table, by name or file; without it what the rig file names, or the
    /// onboard model.
    #[arg(long)]
    specimen: Option<String>,
    /// Safety file: detectors, action ladder, stops, operator's link.
    #[arg(long, default_value = "default")]
    safety: String,
    /// Seed of the first run's noise on the simulated rig; each run takes the next one.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Folder of the runs.
    #[arg(long, default_value = "runs")]
    out: PathBuf,
    /// Refuse to run when the real-time set-up is not complete.
    #[arg(long)]
    require_realtime: bool,
    /// CPU to pin the control thread to; without it the last one.
    #[arg(long)]
    cpu: Option<usize>,
}

/// Runs the subcommand until it is interrupted; a run that goes on is stopped first.
///
/// # Errors
/// Bad configuration, an address that cannot be had or is not safe without tokens.
pub fn execute(args: Args) -> Result<Outcome, CliError> {
    let filter = tracing_subscriber::EnvFilter::try_from_default_env()
        // The publication says itself what becomes of its connections.
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("info,async_nats=off"));
    // A logger that is there already stays.
    let _ = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).try_init();
    if args.tls_certificate.is_some() && rustls::crypto::ring::default_provider().install_default().is_err() {
        return Err(CliError::failed("another TLS library is in use in this process"));
    }
    let publish = publication(&args)?;
    let desk = Desk::new(options(&args)?);
    let listen = Listen {
        address: args.listen,
        hosts: args.hosts,
        token_file: args.token_file,
        tls: args.tls_certificate.zip(args.tls_key),
        page: args.page,
        publish,
    };
    let runtime =
        tokio::runtime::Builder::new_multi_thread().enable_all().build().map_err(CliError::failed)?;
    let ready = |address: &str, page_bytes: usize| {
        eprintln!("the page is {} kB, compressed; Ctrl-C ends the daemon", page_bytes.div_ceil(1000));
        println!("{address}");
    };
    let served = runtime.block_on(async {
        let (mut terminate, mut interrupt) =
            match (signal(SignalKind::terminate()), signal(SignalKind::interrupt())) {
                (Ok(terminate), Ok(interrupt)) => (terminate, interrupt),
                (Err(error), _) | (_, Err(error)) => return Err(DaemonError::Io(error)),
            };
        let stop = async move {
            tokio::select! { _ = terminate.recv() => {}, _ = interrupt.recv() => {} }
            eprintln!("ending; a run that goes on is stopped first");
        };
        serve(desk, listen, ready, stop).await
    });
    match served {
        Ok(()) => Ok(Outcome::Done),
        Err(error @ DaemonError::Access(_)) => Err(CliError::usage(error)),
        Err(error) => Err(CliError::failed(error)),
    }
}

/// What is to be published where, with its secrets looked at.
fn publication(args: &Args) -> Result<Option<PublishSpec>, CliError> {
    let Some(name) = &args.publish else { return Ok(None) };
    // Said without the excerpt of the file, which could show a secret that someone has put there.
    let spec: PublishSpec =
        find("publish", name).and_then(|source| source.parse()).map_err(CliError::usage)?;
    spec.complete(args.table.clone()).map(Some).map_err(CliError::usage)
}

/// Reads every configuration that the arguments name.
fn options(args: &Args) -> Result<Options, CliError> {
    let usage = |error: ConfigError| CliError::Usage(error.into());
    let rig: RigSpec = find("rigs", &args.rig).and_then(|source| source.parse()).map_err(usage)?;
    let mut sweep: SweepSpec =
        find("sweeps", &args.sweep).and_then(|source| source.parse()).map_err(usage)?;
    sweep.acceleration_g = args.case.acceleration_g;
    let safety: SafetySpec = find("safety", &args.safety).and_then(|source| source.parse()).map_err(usage)?;
    let model = match &args.model {
        Some(name) => read_model(name)?,
        None => model_of_case(&args.case),
    };
    let specimen =
        args.specimen.as_ref().or(rig.specimen.as_ref()).map(|name| read_model(name)).transpose()?;
    let case = args.model.is_none().then_some(args.case);
    let cpu = args.cpu.or_else(|| std::thread::available_parallelism().ok().map(|n| n.get() - 1));
    Ok(Options {
        out: args.out.clone(),
        rig,
        work: Work::new(case, sweep, model, specimen),
        seed: args.seed,
        pace: Pace::Wall { cpu, require_realtime: args.require_realtime },
        safety,
    })
}
