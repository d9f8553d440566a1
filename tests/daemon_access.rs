//! Who may do what over HTTP: every cell of rights x endpoints, and what no right helps against: a foreign
//! host, a foreign origin, an old token, a path out of the folder of the runs, a body without end.

use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{Method, Request, StatusCode};
use shaketable::config::Case;
use shaketable::control::session::Pace;
use shaketable::control::setup::model_of_case;
use shaketable::daemon::access::{Access, Right, Rights};
use shaketable::daemon::desk::{Desk, Options};
use shaketable::daemon::http::gate::ENDPOINTS;
use shaketable::daemon::http::{App, LARGEST_BODY, described, router};
use shaketable::daemon::state::State;
use shaketable::daemon::work::Work;
use shaketable::rig::RigSpec;
use shaketable::safety::SafetySpec;
use shaketable::sweep::SweepSpec;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use tower::ServiceExt;

const HOST: &str = "bench.lab:8732";

struct Daemon {
    router: Router,
    desk: Arc<Desk>,
    tokens: BTreeMap<String, String>,
    folder: tempfile::TempDir,
}

fn tokens(path: &Path) -> BTreeMap<String, String> {
    toml::from_str(&std::fs::read_to_string(path).expect("made")).expect("TOML")
}

fn daemon() -> Daemon {
    let folder = tempfile::tempdir().expect("folder");
    let case: Case = "B1-G2-0.05".parse().expect("case");
    let work = Work::new(Some(case), SweepSpec::paper(), model_of_case(&case), None);
    let out = folder.path().join("runs");
    std::fs::create_dir(&out).expect("made");
    let safety = SafetySpec::built_in().expect("valid");
    let options = Options { out, rig: RigSpec::default(), work, seed: 1, pace: Pace::Virtual, safety };
    let desk = Desk::new(options);
    let file = folder.path().join("tokens.toml");
    let address = "0.0.0.0:8732".parse().expect("address");
    let access = Access::new(address, vec!["bench.lab".into()], Some(&file), false).expect("safe");
    let app = App::new(desk.clone(), access, None, None).expect("made");
    Daemon { router: router(app), desk, tokens: tokens(&file), folder }
}

impl Daemon {
    async fn send(&self, request: Request<Body>) -> (StatusCode, Bytes) {
        let answer = self.router.clone().oneshot(request).await.expect("answers");
        let status = answer.status();
        (status, axum::body::to_bytes(answer.into_body(), 8 << 20).await.expect("body"))
    }

    async fn ask(&self, method: &str, path: &str, token: Option<&str>, body: &str) -> StatusCode {
        self.send(self.request(method, path, token, body)).await.0
    }

    fn request(&self, method: &str, path: &str, token: Option<&str>, body: &str) -> Request<Body> {
        let mut request = Request::builder().method(method).uri(path).header("host", HOST);
        if let Some(token) = token {
            request = request.header("authorization", format!("Bearer {token}"));
        }
        if !body.is_empty() {
            request = request.header("content-type", "application/json");
        }
        request.body(Body::from(body.to_owned())).expect("request")
    }

    fn token(&self, name: &str) -> Option<&str> {
        self.tokens.get(name).map(String::as_str)
    }
}

/// What stands in for the parameters of a path.
fn concrete(path: &str) -> String {
    path.replace("{id}", "1")
}

#[tokio::test]
async fn every_cell_of_rights_and_endpoints() {
    let daemon = daemon();
    let callers = [
        ("nobody", Rights::default()),
        ("viewer", Rights::VIEWER),
        ("operator", Rights::OPERATOR),
        ("configurer", Rights::CONFIGURER),
    ];
    let mut cells = 0;
    for (method, path, right) in ENDPOINTS {
        for (name, rights) in callers {
            // An empty body is refused by whoever reads it, after the gate.
            let status = daemon.ask(method, &concrete(path), daemon.token(name), "").await;
            let refused = matches!(status, StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN);
            assert_eq!(refused, !rights.has(*right), "{method} {path} as {name}: {status}");
            let word = if rights.view { StatusCode::FORBIDDEN } else { StatusCode::UNAUTHORIZED };
            assert!(!refused || status == word, "{method} {path} as {name}: {status}");
            assert!(!status.is_server_error(), "{method} {path} as {name}: {status}");
            cells += 1;
        }
    }
    assert_eq!(cells, 4 * ENDPOINTS.len());
    assert_ne!(daemon.desk.state(), State::Running);
}

#[test]
fn the_table_of_rights_and_the_description_name_the_same_endpoints() {
    let text = serde_json::to_value(described()).expect("JSON");
    let mut described = BTreeSet::new();
    for (path, item) in text["paths"].as_object().expect("paths") {
        for (method, operation) in item.as_object().expect("operations") {
            described.insert((method.to_uppercase(), path.clone(), operation["x-right"].clone().to_string()));
        }
    }
    let of_page = ["/", "/app.js", "/app.css", "/icon.svg"];
    let listed: BTreeSet<_> = ENDPOINTS
        .iter()
        .filter(|(_, path, _)| !of_page.contains(path))
        .map(|(method, path, right)| {
            ((*method).to_owned(), (*path).to_owned(), serde_json::to_string(right).expect("JSON"))
        })
        .collect();
    assert_eq!(described, listed);
    assert!(
        ENDPOINTS.iter().all(|(method, path, right)| *right != Right::Anyone
            || path.ends_with("login")
            || *method == "GET")
    );
}

#[tokio::test]
async fn every_viewer_may_stop_and_nothing_else() {
    let daemon = daemon();
    let viewer = daemon.token("viewer");
    assert_eq!(daemon.ask("POST", "/api/v1/session/stop", viewer, "").await, StatusCode::OK);
    assert_eq!(daemon.ask("POST", "/api/v1/session/pre-flight", viewer, "").await, StatusCode::FORBIDDEN);
    // An operator, but the bench is not armed.
    let operator = daemon.token("operator");
    assert_eq!(daemon.ask("POST", "/api/v1/session/start", operator, "").await, StatusCode::CONFLICT);
    assert_eq!(daemon.ask("PUT", "/api/v1/setup/model", operator, "{}").await, StatusCode::FORBIDDEN);
    assert_eq!(daemon.desk.state(), State::Idle);
}

#[tokio::test]
async fn foreign_hosts_and_origins_change_nothing() {
    let daemon = daemon();
    let operator = daemon.token("operator").expect("token").to_owned();
    let with = |headers: &[(&str, &str)]| {
        let mut request = daemon.request("POST", "/api/v1/session/pre-flight", Some(&operator), "");
        for (name, value) in headers {
            let name = axum::http::HeaderName::from_bytes(name.as_bytes()).expect("name");
            request.headers_mut().insert(name, value.parse().expect("value"));
        }
        request
    };
    let refused: [(&[(&str, &str)], StatusCode); 7] = [
        (&[("host", "evil.example:8732")], StatusCode::MISDIRECTED_REQUEST),
        (&[("host", "evil.example")], StatusCode::MISDIRECTED_REQUEST),
        (&[("host", "")], StatusCode::MISDIRECTED_REQUEST),
        (&[("origin", "http://evil.example")], StatusCode::FORBIDDEN),
        (&[("origin", "null")], StatusCode::FORBIDDEN),
        (&[("origin", "https://bench.lab:8732")], StatusCode::FORBIDDEN),
        (&[("sec-fetch-site", "cross-site")], StatusCode::FORBIDDEN),
    ];
    for (headers, expected) in refused {
        assert_eq!(daemon.send(with(headers)).await.0, expected, "{headers:?}");
        assert_eq!(daemon.desk.state(), State::Idle, "{headers:?}");
    }
    let fine = with(&[("origin", "http://bench.lab:8732"), ("sec-fetch-site", "same-origin")]);
    assert_eq!(daemon.send(fine).await.0, StatusCode::OK);
    assert_eq!(daemon.desk.state(), State::PreFlight);
}

#[tokio::test]
async fn no_token_a_wrong_one_and_an_old_one() {
    let daemon = daemon();
    let status = "/api/v1/status";
    let old = daemon.token("viewer").expect("token").to_owned();
    assert_eq!(daemon.ask("GET", status, None, "").await, StatusCode::UNAUTHORIZED);
    assert_eq!(daemon.ask("GET", status, Some(&"0".repeat(64)), "").await, StatusCode::UNAUTHORIZED);
    assert_eq!(daemon.ask("GET", &format!("{status}?token={old}"), None, "").await, StatusCode::UNAUTHORIZED);
    assert_eq!(daemon.ask("GET", status, Some(&old), "").await, StatusCode::OK);
    let path = daemon.folder.path().join("tokens.toml");
    let mut replaced = tokens(&path);
    replaced.insert("viewer".into(), "1".repeat(64));
    let later = std::time::SystemTime::now() + std::time::Duration::from_secs(5);
    std::fs::write(&path, toml::to_string(&replaced).expect("TOML")).expect("written");
    std::fs::File::open(&path).and_then(|file| file.set_modified(later)).expect("set");
    assert_eq!(daemon.ask("GET", status, Some(&old), "").await, StatusCode::UNAUTHORIZED);
    assert_eq!(daemon.ask("GET", status, Some(&"1".repeat(64)), "").await, StatusCode::OK);
}

#[tokio::test]
async fn no_path_leads_out_of_the_folder_of_the_runs() {
    let daemon = daemon();
    let secret = daemon.folder.path().join("secret");
    std::fs::create_dir(&secret).expect("made");
    std::fs::write(secret.join("run.toml"), "secret").expect("written");
    std::fs::write(secret.join("events.jsonl"), "secret").expect("written");
    std::os::unix::fs::symlink(&secret, daemon.folder.path().join("runs/link")).expect("linked");
    let operator = daemon.token("operator");
    let absolute = format!("{}", secret.display()).replace('/', "%2f");
    for name in [
        "..%2fsecret",
        "%2e%2e%2fsecret",
        "..%5csecret",
        "..",
        "%2e%2e",
        ".",
        "link",
        "secret%00",
        "x%2f..%2f..%2fsecret",
        &absolute,
    ] {
        for tail in ["", "/events", "/steps", "/report", "/notes", "/cycles?step=0", "/export?format=csv"] {
            let path = format!("/api/v1/runs/{name}{tail}");
            let (status, body) = daemon.send(daemon.request("GET", &path, operator, "")).await;
            assert!(matches!(status, StatusCode::NOT_FOUND | StatusCode::BAD_REQUEST), "{path}: {status}");
            assert!(!body.windows(6).any(|six| six == b"secret" && !path.contains("secret")), "{path}");
        }
        let path = format!("/api/v1/runs/{name}/notes");
        let status = daemon.ask("PUT", &path, operator, r#"{"text":"x"}"#).await;
        assert!(matches!(status, StatusCode::NOT_FOUND | StatusCode::BAD_REQUEST), "{path}: {status}");
    }
    assert_eq!(std::fs::read_dir(&secret).expect("there").count(), 2, "nothing was written there");
}

#[tokio::test]
async fn a_body_without_end_is_refused_unread() {
    let daemon = daemon();
    let operator = daemon.token("operator").expect("token");
    let announced = Request::builder()
        .method(Method::PUT)
        .uri("/api/v1/setup/sweep")
        .header("host", HOST)
        .header("authorization", format!("Bearer {operator}"))
        .header("content-type", "application/json")
        .header("content-length", "1073741824")
        .body(Body::empty())
        .expect("request");
    assert_eq!(daemon.send(announced).await.0, StatusCode::PAYLOAD_TOO_LARGE);
    // One that does not say how long it is, fed until it is refused.
    let fed = Arc::new(std::sync::atomic::AtomicUsize::new(0));
    let counter = fed.clone();
    let chunk = Bytes::from(vec![b' '; 64 * 1024]);
    let stream = futures_util::stream::repeat_with(move || {
        counter.fetch_add(64 * 1024, std::sync::atomic::Ordering::Relaxed);
        Ok::<_, std::io::Error>(chunk.clone())
    });
    let endless = Request::builder()
        .method(Method::PUT)
        .uri("/api/v1/setup/sweep")
        .header("host", HOST)
        .header("authorization", format!("Bearer {operator}"))
        .header("content-type", "application/json")
        .body(Body::from_stream(stream))
        .expect("request");
    assert_eq!(daemon.send(endless).await.0, StatusCode::PAYLOAD_TOO_LARGE);
    let read = fed.load(std::sync::atomic::Ordering::Relaxed);
    assert!(read <= LARGEST_BODY + 4 * 64 * 1024, "{read} bytes were read");
    assert_eq!(daemon.desk.state(), State::Idle);
}

#[tokio::test]
async fn values_beyond_their_range_are_refused_with_the_range() {
    let daemon = daemon();
    let operator = daemon.token("operator");
    let sweep = r#"{"start_hz":0.5,"stop_hz":0.2,"step_hz":0.1,"acceleration_g":0.05}"#;
    let (status, body) = daemon.send(daemon.request("PUT", "/api/v1/setup/sweep", operator, sweep)).await;
    let text = String::from_utf8_lossy(&body).into_owned();
    assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY, "{text}");
    assert!(text.contains("stop_hz") && text.contains("allowed: above"), "{text}");
    let unknown = r#"{"case":"B9-G2-0.05"}"#;
    let status = daemon.ask("PUT", "/api/v1/setup/case", operator, unknown).await;
    assert_eq!(status, StatusCode::UNPROCESSABLE_ENTITY);
    assert_eq!(daemon.desk.work().sweep, SweepSpec::paper());
}
