//! What `status`, `start`, `stop`, `hold` and `watch` share: how to reach a daemon that runs.

use super::CliError;
use crate::diagnose::live::Evidence;
use serde_json::Value;
use std::path::PathBuf;
use std::time::Duration;

/// Longest that a daemon takes for an answer: the checks on real devices take seconds.
const PATIENCE: Duration = Duration::from_secs(60);

/// Where the daemon is and who asks.
#[derive(Clone, Debug, clap::Args)]
pub struct Reach {
    /// Address of the daemon, as `serve` printed it.
    #[arg(long, default_value = "http://127.0.0.1:8732", env = "SHAKETABLE_URL")]
    url: String,
    /// The daemon's token file; its first token with the right that is needed is used.
    #[arg(long)]
    token_file: Option<PathBuf>,
    /// Certificates to trust beside those of the system, PEM.
    #[arg(long)]
    certificate: Option<PathBuf>,
    /// Name that the journal shows.
    #[arg(long = "as", value_name = "NAME", env = "SHAKETABLE_OPERATOR")]
    operator: Option<String>,
    /// Print JSON on standard output.
    #[arg(long)]
    pub json: bool,
}

/// A daemon that can be asked.
pub struct Client {
    agent: ureq::Agent,
    url: String,
    token: Option<String>,
    operator: Option<String>,
}

#[derive(serde::Deserialize)]
struct Tokens {
    viewer: String,
    operator: String,
}

impl Reach {
    /// The daemon, asked with the token for operators or for viewers.
    ///
    /// # Errors
    /// [`CliError::Usage`] for a token file or certificate that cannot be read.
    pub fn client(&self, operating: bool) -> Result<Client, CliError> {
        let read = |path: &PathBuf| {
            std::fs::read(path).map_err(|error| CliError::usage(format!("{}: {error}", path.display())))
        };
        let token = match &self.token_file {
            None => None,
            Some(path) => {
                let text = String::from_utf8_lossy(&read(path)?).into_owned();
                // Not the parser's own words: they quote the line, and with it a token.
                let tokens: Tokens = toml::from_str(&text).map_err(|_| {
                    CliError::usage(format!("{} is no token file of a daemon", path.display()))
                })?;
                Some(if operating { tokens.operator } else { tokens.viewer })
            }
        };
        let mut config =
            ureq::Agent::config_builder().timeout_global(Some(PATIENCE)).http_status_as_error(false);
        if let Some(path) = &self.certificate {
            let pem = read(path)?;
            let certificate = ureq::tls::Certificate::from_pem(&pem)
                .map_err(|error| CliError::usage(format!("{}: {error}", path.display())))?;
            let roots = ureq::tls::RootCerts::new_with_certs(&[certificate]);
            config = config.tls_config(ureq::tls::TlsConfig::builder().root_certs(roots).build());
        }
        // A second call finds the first one's provider, which is the same.
        let _ = rustls::crypto::ring::default_provider().install_default();
        let url = self.url.trim_end_matches('/').to_owned();
        Ok(Client { agent: config.build().into(), url, token, operator: self.operator.clone() })
    }
}

impl Client {
    /// Address of the daemon.
    pub fn url(&self) -> &str {
        &self.url
    }

    /// Its token, if it has one.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Gets something.
    ///
    /// # Errors
    /// [`CliError::Failed`] when the daemon is not there or refuses.
    pub fn get(&self, path: &str) -> Result<Value, CliError> {
        let mut request = self.agent.get(format!("{}{path}", self.url));
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        self.answer(request.call())
    }

    /// Asks for something, with a JSON body if one is given.
    ///
    /// # Errors
    /// [`CliError::Failed`] when the daemon is not there or refuses.
    pub fn post(&self, path: &str, body: Option<&Value>) -> Result<Value, CliError> {
        let mut request = self.agent.post(format!("{}{path}", self.url));
        if let Some(token) = &self.token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        if let Some(operator) = &self.operator {
            request = request.header("x-operator", operator);
        }
        self.answer(match body {
            Some(body) => request.send_json(body),
            None => request.send_empty(),
        })
    }

    fn answer(
        &self,
        answer: Result<ureq::http::Response<ureq::Body>, ureq::Error>,
    ) -> Result<Value, CliError> {
        let mut answer = answer.map_err(|error| {
            CliError::failed(format!(
                "no daemon answers at {}: {error}; `shaketable serve` starts one",
                self.url
            ))
        })?;
        let status = answer.status();
        let body: Value = answer.body_mut().read_json().unwrap_or_default();
        if status.is_success() {
            return Ok(body);
        }
        let message = body["message"].as_str().unwrap_or("it does not say why");
        Err(CliError::failed(format!("the daemon refuses ({status}): {message}")))
    }
}

/// The status in a few lines.
pub fn lines(status: &Value) -> String {
    let text = |value: &Value| value.as_str().unwrap_or("-").to_owned();
    let setup = &status["setup"];
    let mut out = format!("{} since {}\n", text(&status["state"]), text(&status["since_utc"]));
    if let Some(cause) = status["cause"]["detector"].as_str() {
        out += &format!("cause:   {cause} ({})\n", text(&status["cause"]["text"]));
    }
    out += &format!("rig:     {}\nmodel:   {}\n", text(&setup["rig"]), text(&setup["model"]));
    if status["run"].is_object() {
        out += &format!("run:     {}\n         {}\n", text(&status["run"]["id"]), progress(status));
    }
    if let Some(id) = status["ended"]["id"].as_str() {
        let ended = &status["ended"];
        out +=
            &format!("last:    {id}, {}, {} samples lost\n", text(&ended["outcome"]), ended["lost_samples"]);
    }
    let possible: Vec<&str> =
        status["possible"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    out += &format!("now:     {}\n", possible.join(", "));
    out
}

/// Progress of the run in one line.
pub fn progress(status: &Value) -> String {
    let run = &status["run"];
    let number = |value: &Value| value.as_f64().unwrap_or(0.0);
    format!(
        "{:<9} {:>5.1} %  step {}/{} {:.2} Hz {}  model error A {:.1} %, D {:.1} %  ETA {:.0} s  slips {}{}",
        status["state"].as_str().unwrap_or("-"),
        100.0 * number(&run["progress"]),
        run["step"].as_u64().map_or(0, |step| step + 1),
        run["steps"],
        number(&run["frequency_hz"]),
        run["direction"].as_str().unwrap_or(""),
        100.0 * number(&run["nrmse_a"]),
        100.0 * number(&run["nrmse_d"]),
        number(&run["eta_s"]),
        run["slips"],
        serde_json::from_value::<Evidence>(run["evidence"].clone())
            .map_or_else(|_| String::new(), |found| format!("  {}", found.line()))
    )
}
