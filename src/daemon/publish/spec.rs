//! What is published where: the file that `serve --publish` names, and the secrets file that it may name in turn. Everything
//! is checked before the daemon listens; a secret never stands in an address, an error or a log.

use super::super::access::private;
use super::super::live::window_of;
use crate::config::Check;
use async_nats::{ConnectOptions, ServerAddr};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Longest name of a table.
const LONGEST_NAME: usize = 32;

/// A publication file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishSpec {
    /// The server: `nats://host:port`, or `tls://host:port` where nothing but TLS will do.
    pub server: String,
    /// Name of this table, a word of every subject; `--table` goes before it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<String>,
    /// Rows that two points of the live data stand for: 1 (every row), 16, 64, 128 or 512.
    #[serde(default = "default_live_rows")]
    pub live_rows: u64,
    /// File with the secrets, mode 0600.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub credentials: Option<PathBuf>,
    /// Certificates to trust in place of those of the system, PEM.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub trust: Option<PathBuf>,
    /// Certificate chain and key that the server may ask for, PEM.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub certificate: Option<Certificate>,
}

/// A certificate of our own.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Certificate {
    /// Certificate chain, PEM.
    pub chain: PathBuf,
    /// Key, PEM.
    pub key: PathBuf,
}

fn default_live_rows() -> u64 {
    64
}

/// What cannot be published so.
#[derive(Debug, thiserror::Error)]
pub enum PublishError {
    /// No table was named, or not by a word of a subject.
    #[error("{0}")]
    Table(String),
    /// The secrets cannot be used.
    #[error("credentials {path}: {reason}")]
    Credentials {
        /// Their file.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// A password would travel in the clear.
    #[error(
        "a password or token for `{0}` would travel in the clear: use tls:// for a server on another machine"
    )]
    Clear(String),
}

/// Whether a name is one word of a subject.
fn is_word(name: &str) -> bool {
    let fine = |c: char| c.is_ascii_alphanumeric() || "-_".contains(c);
    (1..=LONGEST_NAME).contains(&name.len()) && name.chars().all(fine)
}

fn refused_name(name: &str) -> String {
    format!("`{name}`; allowed: up to {LONGEST_NAME} letters, digits, - and _")
}

impl Check for PublishSpec {
    fn check(&self) -> Result<(), (String, String)> {
        let refuse = |key: &str, reason: String| Err((key.to_owned(), reason));
        let allowed = "allowed: nats://host:port or tls://host:port";
        // Said without the text itself, which may hold a secret.
        if self.server.contains('@') {
            return refuse(
                "server",
                format!("no user and no secret belong here, but in `credentials`; {allowed}"),
            );
        }
        let known = ["nats://", "tls://"].iter().any(|scheme| self.server.starts_with(scheme));
        match self.server.parse::<ServerAddr>() {
            Ok(server) if known && !server.host().is_empty() => {}
            Ok(_) => return refuse("server", format!("`{}`; {allowed}", self.server)),
            Err(error) => return refuse("server", format!("`{}`: {error}; {allowed}", self.server)),
        }
        if let Some(name) = self.table.as_ref().filter(|name| !is_word(name)) {
            return refuse("table", refused_name(name));
        }
        if window_of(self.live_rows).is_none() {
            return refuse("live_rows", format!("{}; allowed: 1, 16, 64, 128 or 512", self.live_rows));
        }
        Ok(())
    }
}

/// The secrets as they stand in their file: one way to log in.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, untagged)]
enum Secrets {
    Password { user: String, password: String },
    Token { token: String },
    Seed { nkey_seed: String },
}

impl PublishSpec {
    /// Completes the file with the name that was given for the table, and looks whether the secrets can be used.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn complete(mut self, table: Option<String>) -> Result<Self, PublishError> {
        self.table = table.or(self.table);
        match &self.table {
            None => {
                return Err(PublishError::Table(
                    "publishing needs a name for this table: --table NAME".into(),
                ));
            }
            Some(name) if !is_word(name) => {
                return Err(PublishError::Table(format!("--table {}", refused_name(name))));
            }
            Some(_) => {}
        }
        self.options()?;
        Ok(self)
    }

    /// Name of the table; empty before [`PublishSpec::complete`].
    pub fn table(&self) -> &str {
        self.table.as_deref().unwrap_or_default()
    }

    /// How to connect; the secrets are read anew, so that a replaced file counts at the next connection.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn options(&self) -> Result<ConnectOptions, PublishError> {
        let mut options = ConnectOptions::new();
        if let Some(path) = &self.credentials {
            let error = |reason: String| PublishError::Credentials { path: path.clone(), reason };
            let text = read_private(path).map_err(error)?;
            options = if text.contains("BEGIN NATS USER JWT") {
                // Not the crate's own words, which may quote the file.
                let known = options.credentials(&text);
                known.map_err(|_| error("not the .creds file of a user: a JWT and an nkey seed".into()))?
            } else {
                self.log_in(options, &text, error)?
            };
        }
        if let Some(path) = &self.trust {
            options = options.add_root_certificates(path.clone());
        }
        if let Some(Certificate { chain, key }) = &self.certificate {
            options = options.add_client_certificate(chain.clone(), key.clone());
        }
        Ok(options)
    }

    fn log_in(
        &self,
        options: ConnectOptions,
        text: &str,
        error: impl Fn(String) -> PublishError,
    ) -> Result<ConnectOptions, PublishError> {
        // Not the parser's own words: they quote the line.
        let secrets: Secrets = toml::from_str(text).map_err(|_| {
            error("expected a .creds file, or as TOML user and password, or token, or nkey_seed".into())
        })?;
        let options = match secrets {
            // Signs what the server asks; the seed itself stays here.
            Secrets::Seed { nkey_seed } => return Ok(options.nkey(nkey_seed)),
            Secrets::Password { user, password } => options.user_and_password(user, password),
            Secrets::Token { token } => options.token(token),
        };
        match self.server.parse::<ServerAddr>() {
            Ok(server) if server.tls_required() || is_here(server.host()) => Ok(options),
            _ => Err(PublishError::Clear(self.server.clone())),
        }
    }
}

fn is_here(host: &str) -> bool {
    let host = host.trim_start_matches('[').trim_end_matches(']');
    host == "localhost" || host.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

fn read_private(path: &Path) -> Result<String, String> {
    private(path)?;
    std::fs::read_to_string(path).map_err(|error| error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::builtin::{find, names};
    use crate::config::parse_toml;
    use std::os::unix::fs::PermissionsExt;

    fn parsed(text: &str) -> Result<PublishSpec, String> {
        parse_toml("lab.toml", text).map_err(|error| error.to_string())
    }

    #[test]
    fn built_in_files_are_valid_and_need_a_table() {
        for name in names("publish") {
            let spec: PublishSpec = find("publish", name).and_then(|source| source.parse()).expect("valid");
            let nameless = spec.clone().complete(None).expect_err("no name").to_string();
            assert!(nameless.contains("--table"), "{nameless}");
            assert_eq!(spec.complete(Some("east-2".into())).expect("complete").table(), "east-2");
        }
    }

    #[test]
    fn a_table_is_one_word_of_a_subject() {
        let spec = parsed("server = \"nats://127.0.0.1:4222\"\ntable = \"west\"\n").expect("valid");
        assert_eq!(spec.clone().complete(None).expect("named in the file").table(), "west");
        for name in ["", "a.b", "*", ">", "a b", "ü", &"x".repeat(33)] {
            assert!(spec.clone().complete(Some(name.into())).is_err(), "{name}");
            let text = format!("server = \"nats://127.0.0.1:4222\"\ntable = \"{name}\"\n");
            assert!(parsed(&text).expect_err("refused").starts_with("lab.toml:2: table"), "{name}");
        }
    }

    #[test]
    fn a_secret_has_no_place_in_an_address() {
        for server in ["nats://me:hunter2@lab", "tls://hunter2@lab:4222"] {
            let error = parsed(&format!("server = \"{server}\"\n")).expect_err("refused");
            assert!(error.contains("credentials") && !error.contains("hunter2"), "{error}");
        }
        for server in ["http://lab", "lab:4222", "nats://", "wss://lab"] {
            let error = parsed(&format!("server = \"{server}\"\n")).expect_err("refused");
            assert!(error.starts_with("lab.toml:1: server"), "{error}");
        }
        assert!(parsed("server = \"nats://lab\"\nlive_rows = 100\n").expect_err("refused").contains("512"));
    }

    #[test]
    fn secrets_are_private_and_leave_no_trace_in_errors() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("secrets.toml");
        let used = |server: &str, secrets: &str, mode: u32| {
            std::fs::write(&path, secrets).expect("written");
            std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).expect("mode");
            let text = format!("server = \"{server}\"\ncredentials = \"{}\"\n", path.display());
            let spec = parsed(&text).expect("valid");
            spec.complete(Some("east".into())).map(|_| ()).map_err(|error| error.to_string())
        };
        let password = "user = \"table\"\npassword = \"hunter2\"\n";
        assert_eq!(used("nats://127.0.0.1:4222", password, 0o600), Ok(()));
        assert_eq!(used("tls://bus.lab", password, 0o600), Ok(()));
        assert_eq!(used("nats://bus.lab", "nkey_seed = \"hunter2\"\n", 0o600), Ok(()));
        assert_eq!(used("nats://[::1]:4222", "token = \"hunter2\"\n", 0o600), Ok(()));
        let refused = [
            (used("nats://bus.lab", password, 0o600), "tls://"),
            (used("nats://127.0.0.1", password, 0o644), "0600"),
            (used("nats://127.0.0.1", "user = \"hunter2\"\n", 0o600), "expected"),
            (used("nats://127.0.0.1", "password = hunter2\n", 0o600), "expected"),
            (used("nats://127.0.0.1", "-----BEGIN NATS USER JWT-----\nhunter2\n", 0o600), ".creds"),
        ];
        for (outcome, word) in refused {
            let error = outcome.expect_err(word);
            assert!(error.contains(word) && !error.contains("hunter2"), "{error}");
        }
    }
}
