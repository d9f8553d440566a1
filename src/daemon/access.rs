//! Who may do what: rights, tokens and the checks that every request passes before anything looks at it.
//! A wrong host (DNS rebinding), a foreign origin (cross-site requests) and a missing right are refused
//! here, by one table of endpoints; an endpoint that is not in the table is refused too.

use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::fs::{Metadata, OpenOptions};
use std::io::Write;
use std::net::{IpAddr, SocketAddr};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};
use subtle::ConstantTimeEq;
use utoipa::ToSchema;

/// One right. Each token has its own; a page that was given two tokens has both.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Right {
    /// Anyone who reaches the daemon: the page itself, logging in.
    Anyone,
    /// See everything, stop the table.
    View,
    /// Check, arm, start, hold, choose sweep and case.
    Operate,
    /// Change the onboard model and the rig's switches.
    Configure,
}

/// Rights of a caller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, ToSchema)]
pub struct Rights {
    /// See everything, stop the table.
    pub view: bool,
    /// Check, arm, start, hold.
    pub operate: bool,
    /// Change model and rig.
    pub configure: bool,
}

impl Rights {
    /// All of them.
    pub const ALL: Self = Self { view: true, operate: true, configure: true };
    /// Those of the token for watching.
    pub const VIEWER: Self = Self { view: true, operate: false, configure: false };
    /// Those of the token for operating.
    pub const OPERATOR: Self = Self { view: true, operate: true, configure: false };
    /// Those of the token for configuring.
    pub const CONFIGURER: Self = Self { view: true, operate: false, configure: true };

    /// Whether a right is among them.
    pub fn has(self, right: Right) -> bool {
        match right {
            Right::Anyone => true,
            Right::View => self.view,
            Right::Operate => self.operate,
            Right::Configure => self.configure,
        }
    }

    fn or(self, other: Self) -> Self {
        Self {
            view: self.view || other.view,
            operate: self.operate || other.operate,
            configure: self.configure || other.configure,
        }
    }

    /// A word for the journal.
    pub fn word(self) -> &'static str {
        match (self.operate, self.configure) {
            (true, true) => "operator and configurer",
            (true, false) => "operator",
            (false, true) => "configurer",
            (false, false) => "viewer",
        }
    }
}

/// Why the daemon cannot decide who may do what.
#[derive(Debug, thiserror::Error)]
pub enum AccessError {
    /// The file cannot be read or made.
    #[error("token file {path}: {reason}")]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        reason: String,
    },
    /// An address that others reach needs tokens.
    #[error("{0} can be reached by others: listening there needs --token-file (made on first use)")]
    Open(SocketAddr),
}

/// The tokens as they stand in their file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Tokens {
    viewer: String,
    operator: String,
    configurer: String,
}

/// Characters of a token: 256 bits in hexadecimal.
const TOKEN_LENGTH: usize = 64;
/// Sessions of pages that are remembered.
const MOST_SESSIONS: usize = 1000;
/// A session that was not used for so long is forgotten.
const SESSION_LIFE: Duration = Duration::from_secs(12 * 3600);

fn random() -> Result<String, std::io::Error> {
    let mut bytes = [0; TOKEN_LENGTH / 2];
    getrandom::fill(&mut bytes).map_err(std::io::Error::other)?;
    Ok(crate::record::samples::hex(&bytes))
}

/// Metadata of a file with secrets, which is refused when others can read it.
///
/// # Errors
/// The reason, without the path.
pub(super) fn private(path: &Path) -> Result<Metadata, String> {
    let metadata = std::fs::metadata(path).map_err(|error| error.to_string())?;
    match metadata.mode() & 0o777 {
        mode if mode & 0o077 != 0 => {
            Err(format!("mode {mode:04o}; allowed: 0600, readable by its owner only"))
        }
        _ => Ok(metadata),
    }
}

/// A file of tokens, made on first use and read again when it was changed: the old ones are void then.
struct TokenFile {
    path: PathBuf,
    read: Mutex<Option<(SystemTime, Tokens)>>,
}

impl TokenFile {
    fn open(path: &Path) -> Result<Self, AccessError> {
        let error =
            |reason: std::io::Error| AccessError::File { path: path.to_owned(), reason: reason.to_string() };
        if !path.exists() {
            let tokens = Tokens {
                viewer: random().map_err(error)?,
                operator: random().map_err(error)?,
                configurer: random().map_err(error)?,
            };
            let text = toml::to_string(&tokens).map_err(|e| error(std::io::Error::other(e)))?;
            let mut file =
                OpenOptions::new().write(true).create_new(true).mode(0o600).open(path).map_err(error)?;
            file.write_all(text.as_bytes()).map_err(error)?;
        }
        let file = Self { path: path.to_owned(), read: Mutex::new(None) };
        file.tokens()?;
        Ok(file)
    }

    fn tokens(&self) -> Result<Tokens, AccessError> {
        let error = |reason: String| AccessError::File { path: self.path.clone(), reason };
        let metadata = private(&self.path).map_err(error)?;
        let changed = metadata.modified().map_err(|e| error(e.to_string()))?;
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((at, tokens)) = read.as_ref().filter(|(at, _)| *at == changed) {
            let _ = at;
            return Ok(tokens.clone());
        }
        let text = std::fs::read_to_string(&self.path).map_err(|e| error(e.to_string()))?;
        // Not the parser's own words: they quote the line, and with it a token.
        let tokens: Tokens = toml::from_str(&text)
            .map_err(|_| error("expected viewer, operator and configurer, a text each".into()))?;
        let short = [&tokens.viewer, &tokens.operator, &tokens.configurer].iter().any(|t| t.len() < 32);
        if short {
            return Err(error("a token is shorter than 32 characters".into()));
        }
        *read = Some((changed, tokens.clone()));
        Ok(tokens)
    }

    fn rights(&self, token: &str) -> Option<Rights> {
        let tokens = match self.tokens() {
            Ok(tokens) => tokens,
            Err(error) => {
                tracing::error!(%error, "nobody can log in");
                return None;
            }
        };
        let same = |known: &str| bool::from(known.as_bytes().ct_eq(token.as_bytes()));
        // All three are compared whatever the first says, so that the time tells nothing.
        let found = [
            (same(&tokens.viewer), Rights::VIEWER),
            (same(&tokens.operator), Rights::OPERATOR),
            (same(&tokens.configurer), Rights::CONFIGURER),
        ];
        found.into_iter().filter(|(same, _)| *same).map(|(_, rights)| rights).next()
    }
}

/// A page that has logged in.
struct PageSession {
    tokens: Vec<String>,
    used: Instant,
}

/// Decides about callers.
pub struct Access {
    address: SocketAddr,
    hosts: Vec<String>,
    secure: bool,
    tokens: Option<TokenFile>,
    sessions: Mutex<HashMap<String, PageSession>>,
}

impl Access {
    /// For an address that is listened on, further names that it is known by, and a token file.
    ///
    /// # Errors
    /// [`AccessError`] when others could reach the address without a token, or the file is not safe.
    pub fn new(
        address: SocketAddr,
        hosts: Vec<String>,
        token_file: Option<&Path>,
        secure: bool,
    ) -> Result<Self, AccessError> {
        if !address.ip().is_loopback() && token_file.is_none() {
            return Err(AccessError::Open(address));
        }
        let tokens = token_file.map(TokenFile::open).transpose()?;
        Ok(Self { address, hosts, secure, tokens, sessions: Mutex::default() })
    }

    /// The port became known only when it was listened on.
    pub fn at(self, address: SocketAddr) -> Self {
        Self { address, ..self }
    }

    /// A token is asked for.
    pub fn needs_token(&self) -> bool {
        self.tokens.is_some()
    }

    /// Cookies go over TLS only.
    pub fn is_secure(&self) -> bool {
        self.secure
    }

    /// Whether a `Host` is one of ours: a name that others could point at us is not (DNS rebinding).
    pub fn host_is_ours(&self, host: &str) -> bool {
        let default = if self.secure { 443 } else { 80 };
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.contains(']') => (name, port.parse::<u16>().ok()),
            _ => (host, Some(default)),
        };
        if port != Some(self.address.port()) {
            return false;
        }
        let name = name.trim_start_matches('[').trim_end_matches(']');
        if self.hosts.iter().any(|known| known.eq_ignore_ascii_case(name)) {
            return true;
        }
        let loopback = self.address.ip().is_loopback();
        match name.parse::<IpAddr>() {
            // A number cannot be rebound; on loopback only loopback's own makes sense.
            Ok(ip) => !loopback || ip.is_loopback(),
            Err(_) => loopback && name.eq_ignore_ascii_case("localhost"),
        }
    }

    /// Whether an `Origin` is the page that we served ourselves under this `Host`.
    pub fn origin_is_ours(&self, origin: &str, host: &str) -> bool {
        let scheme = if self.secure { "https://" } else { "http://" };
        origin.strip_prefix(scheme).is_some_and(|rest| rest.eq_ignore_ascii_case(host))
    }

    /// The rights of a caller, by bearer token or by the cookie of a page.
    pub fn rights(&self, bearer: Option<&str>, cookie: Option<&str>) -> Rights {
        let Some(tokens) = &self.tokens else { return Rights::ALL };
        if let Some(bearer) = bearer {
            return tokens.rights(bearer).unwrap_or_default();
        }
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        let session = cookie.and_then(|cookie| sessions.get_mut(cookie));
        let Some(session) = session.filter(|session| session.used.elapsed() < SESSION_LIFE) else {
            return Rights::default();
        };
        session.used = Instant::now();
        // Tokens that were replaced meanwhile give nothing any more.
        let each = session.tokens.iter().filter_map(|token| tokens.rights(token));
        each.fold(Rights::default(), Rights::or)
    }

    /// Logs a page in with a token; returns the value of its cookie. A page that is logged in already keeps
    /// what it has.
    pub fn log_in(&self, token: &str, cookie: Option<&str>) -> Option<(String, Rights)> {
        let tokens = self.tokens.as_ref()?;
        tokens.rights(token)?;
        let mut sessions = self.sessions.lock().unwrap_or_else(PoisonError::into_inner);
        sessions.retain(|_, session| session.used.elapsed() < SESSION_LIFE);
        let mut held =
            cookie.and_then(|cookie| sessions.remove(cookie)).map(|s| s.tokens).unwrap_or_default();
        if sessions.len() >= MOST_SESSIONS
            && let Some(oldest) = sessions.iter().min_by_key(|(_, s)| s.used).map(|(key, _)| key.clone())
        {
            sessions.remove(&oldest);
        }
        if !held.iter().any(|known| known == token) {
            held.push(token.to_owned());
        }
        let rights = held.iter().filter_map(|token| tokens.rights(token)).fold(Rights::default(), Rights::or);
        let fresh = random().ok()?;
        sessions.insert(fresh.clone(), PageSession { tokens: held, used: Instant::now() });
        Some((fresh, rights))
    }

    /// Logs a page out.
    pub fn log_out(&self, cookie: &str) {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner).remove(cookie);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn access(address: &str, hosts: &[&str], file: Option<&Path>) -> Result<Access, AccessError> {
        let hosts = hosts.iter().map(|&host| host.to_owned()).collect();
        Access::new(address.parse().expect("address"), hosts, file, false)
    }

    #[test]
    fn only_our_own_names_are_hosts() {
        let local = access("127.0.0.1:8732", &[], None).expect("loopback");
        for host in ["127.0.0.1:8732", "localhost:8732", "[::1]:8732", "LOCALHOST:8732"] {
            assert!(local.host_is_ours(host), "{host}");
        }
        for host in
            ["evil.example:8732", "127.0.0.1:80", "127.0.0.1", "10.0.0.1:8732", "", "localhost.evil:8732"]
        {
            assert!(!local.host_is_ours(host), "{host}");
        }
        assert!(local.origin_is_ours("http://localhost:8732", "localhost:8732"));
        for origin in ["https://localhost:8732", "http://evil.example", "null", "http://127.0.0.1:8732"] {
            assert!(!local.origin_is_ours(origin, "localhost:8732"), "{origin}");
        }
        let folder = tempfile::tempdir().expect("folder");
        let file = folder.path().join("tokens");
        let lab = access("0.0.0.0:8732", &["bench.lab"], Some(&file)).expect("with tokens");
        assert!(lab.host_is_ours("bench.lab:8732") && lab.host_is_ours("10.1.2.3:8732"));
        assert!(!lab.host_is_ours("evil.example:8732") && !lab.host_is_ours("localhost:8732"));
    }

    #[test]
    fn others_need_a_token_and_a_safe_file() {
        assert!(matches!(access("0.0.0.0:1", &[], None), Err(AccessError::Open(_))));
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        let access = access("0.0.0.0:1", &[], Some(&path)).expect("made");
        let mode = std::fs::metadata(&path).expect("there").mode() & 0o777;
        assert_eq!(mode, 0o600);
        let text = std::fs::read_to_string(&path).expect("text");
        let tokens: Tokens = toml::from_str(&text).expect("TOML");
        assert_eq!(tokens.viewer.len(), TOKEN_LENGTH);
        assert_eq!(access.rights(Some(&tokens.operator), None), Rights::OPERATOR);
        assert_eq!(access.rights(Some("wrong"), None), Rights::default());
        assert_eq!(access.rights(None, None), Rights::default());
        let mut open = std::fs::metadata(&path).expect("there").permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut open, 0o644);
        std::fs::set_permissions(&path, open).expect("set");
        assert_eq!(
            access.rights(Some(&tokens.operator), None),
            Rights::default(),
            "a file for all is no secret"
        );
    }

    #[test]
    fn a_page_holds_what_its_tokens_give_until_they_are_replaced() {
        let folder = tempfile::tempdir().expect("folder");
        let path = folder.path().join("tokens");
        let access = access("0.0.0.0:1", &[], Some(&path)).expect("made");
        let old: Tokens = toml::from_str(&std::fs::read_to_string(&path).expect("text")).expect("TOML");
        let (cookie, rights) = access.log_in(&old.viewer, None).expect("known");
        assert_eq!(rights, Rights::VIEWER);
        let (both, rights) = access.log_in(&old.operator, Some(&cookie)).expect("known");
        assert_eq!(rights, Rights::OPERATOR);
        assert_eq!(access.rights(None, Some(&cookie)), Rights::default(), "the first cookie is spent");
        assert!(access.log_in("wrong", Some(&both)).is_none());
        let new = Tokens { operator: random().expect("random"), ..old.clone() };
        let later = SystemTime::now() + Duration::from_secs(5);
        std::fs::write(&path, toml::to_string(&new).expect("text")).expect("written");
        std::fs::File::open(&path).and_then(|file| file.set_modified(later)).expect("set");
        assert_eq!(access.rights(None, Some(&both)), Rights::VIEWER, "the old operator token is void");
        assert_eq!(access.rights(Some(&old.operator), None), Rights::default());
        access.log_out(&both);
        assert_eq!(access.rights(None, Some(&both)), Rights::default());
    }
}
