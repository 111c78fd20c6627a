//! Builds Zenoh's configuration of a node: defaults, the user's file, endpoints, protection, in this order.

use std::net::TcpListener;
use std::path::Path;
use std::time::Duration;

use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use serde_json::{Value, json};

use crate::protection::{Protection, access_control};
use crate::{BusConfig, OpenError, ZenohConfig};

/// Path of Zenoh's TLS settings.
const TLS: &str = "/transport/link/tls";

/// Zenoh's own configuration of a node, as JSON, with which a program can join by any Zenoh package. It
/// contains the node's private key.
///
/// # Errors
/// [`OpenError`] for a configuration file that cannot be used, or has partial TLS.
pub fn zenoh_configuration(bus: &BusConfig) -> Result<String, OpenError> {
    settings(bus).map(|settings| format!("{settings:#}\n"))
}

/// Whirlstand's settings, overridden by the user's file, by the endpoints in the launch file, and by the
/// protection of the bench.
pub(crate) fn settings(bus: &BusConfig) -> Result<Value, OpenError> {
    let zenoh = &bus.zenoh;
    let mut settings = defaults(bus.wait.congestion);
    if let Some(path) = &zenoh.config {
        merge(&mut settings, zenoh_file(path)?);
    }
    for (side, endpoints) in [("listen", &zenoh.listen), ("connect", &zenoh.connect)] {
        if !endpoints.is_empty() {
            settings[side]["endpoints"] = json!(endpoints);
        }
    }
    let wrong = |reason| OpenError::ZenohConfig { path: zenoh.config.clone(), reason };
    if let Some(protection) = &zenoh.protection {
        protect(&mut settings, &bus.bench, protection).map_err(wrong)?;
    }
    check_tls(&mut settings).map_err(wrong)?;
    Ok(settings)
}

fn defaults(congestion: Duration) -> Value {
    json!({
        "mode": "peer",
        "listen": { "endpoints": ["tcp/127.0.0.1:0"] },
        "connect": {
            "timeout_ms": -1,
            "exit_on_failure": false,
            "retry": { "period_init_ms": 20, "period_max_ms": 500, "period_increase_factor": 2 },
        },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": { "link": { "tx": { "queue": {
            "size": { "real_time": 16 },
            "congestion_control": { "drop": { "wait_before_drop": congestion.as_micros() as u64 } },
        } } } },
    })
}

/// Reads Zenoh's own configuration file.
fn zenoh_file(path: &Path) -> Result<Value, OpenError> {
    let text =
        std::fs::read_to_string(path).map_err(|source| OpenError::File { path: path.into(), source })?;
    let bad = |reason: String| OpenError::ZenohConfig { path: Some(path.into()), reason };
    let user: Value = json5::from_str(&text).map_err(|e| bad(e.to_string()))?;
    if !user.is_object() {
        return Err(bad("it must be an object, { ... }".into()));
    }
    Ok(user)
}

impl ZenohConfig {
    /// All endpoints of this configuration, including those of the user's file, and whether that file has its
    /// own protection (TLS or access control).
    ///
    /// # Errors
    /// [`OpenError`] for a file that cannot be read.
    pub fn endpoints_and_own_protection(&self) -> Result<(Vec<String>, bool), OpenError> {
        let user = self.config.as_deref().map_or(Ok(Value::Null), zenoh_file)?;
        let mut all = [self.listen.clone(), self.connect.clone()].concat();
        for side in ["listen", "connect"] {
            collect(&user[side]["endpoints"], &mut all);
        }
        let own = is_given(user.pointer(TLS)) || is_given(user.get("access_control"));
        Ok((all, own))
    }
}

/// Adds mutual TLS with the node's certificate on every link, and access control by the names in the
/// certificates.
fn protect(settings: &mut Value, bench: &str, protection: &Protection) -> Result<(), String> {
    for side in ["listen", "connect"] {
        let mut all = Vec::new();
        collect(&settings[side]["endpoints"], &mut all);
        let all = all.iter().map(|e| over_tls(e)).collect::<Result<Vec<_>, _>>()?;
        settings[side]["endpoints"] = json!(all);
    }
    let identity = &protection.identity;
    let [authority, certificate, key] =
        [&identity.authority, &identity.certificate, &identity.key].map(|pem| BASE64.encode(pem));
    settings["transport"]["link"]["tls"] = json!({
        "root_ca_certificate_base64": authority,
        "listen_certificate_base64": certificate, "listen_private_key_base64": key,
        "connect_certificate_base64": certificate, "connect_private_key_base64": key,
        "enable_mtls": true, "verify_name_on_connect": true,
    });
    settings["transport"]["link"]["protocols"] = json!(["tls"]);
    settings["access_control"] = access_control(bench, &protection.members);
    Ok(())
}

/// The same endpoint over TLS.
///
/// # Errors
/// A sentence, for a protocol that TLS cannot replace.
pub fn over_tls(endpoint: &str) -> Result<String, String> {
    match endpoint.split_once('/') {
        Some(("tls", _)) => Ok(endpoint.into()),
        Some(("tcp", address)) => Ok(format!("tls/{address}")),
        _ => Err(format!(
            "a protected bench speaks TLS, which '{endpoint}' does not: write tls/ADDRESS:PORT, or leave the bench \
             unprotected with [security] mode = \"open\""
        )),
    }
}

/// True when a session with these settings uses TLS on any link.
pub(crate) fn has_tls(settings: &Value) -> bool {
    let mut endpoints = Vec::new();
    ["listen", "connect"].iter().for_each(|side| collect(&settings[side]["endpoints"], &mut endpoints));
    is_given(settings.pointer(TLS)) || endpoints.iter().any(|e| e.starts_with("tls/"))
}

/// Refuses partial TLS: with a certificate every link must use it.
fn check_tls(settings: &mut Value) -> Result<(), String> {
    for kind in ["usrpwd", "pubkey"] {
        if is_given(settings.pointer(&format!("/transport/auth/{kind}"))) {
            return Err(format!(
                "transport.auth.{kind} is set, which this program does not know and would ignore: protect the bench with \
                 [security] in the launch file, or with transport.link.tls"
            ));
        }
    }
    let tls = settings.pointer(TLS).cloned().unwrap_or(Value::Null);
    let given = |key: &str| is_given(tls.get(key)) || is_given(tls.get(format!("{key}_base64")));
    let mtls = tls["enable_mtls"] == true;
    let pairs =
        [("listen_certificate", "listen_private_key"), ("connect_certificate", "connect_private_key")];
    let asked = mtls || given("root_ca_certificate") || pairs.iter().any(|(c, k)| given(c) || given(k));
    if !asked {
        return Ok(());
    }
    let mut missing = Vec::new();
    for (certificate, key) in pairs {
        for (one, other) in [(certificate, key), (key, certificate)] {
            if (mtls || given(other)) && !given(one) {
                missing.push(one);
            }
        }
    }
    if mtls && !given("root_ca_certificate") {
        missing.push("root_ca_certificate");
    }
    if !missing.is_empty() {
        return Err(format!(
            "TLS is set up by halves: {} is missing under transport.link.tls",
            missing.join(", ")
        ));
    }
    let is_tls = |protocol: &str| matches!(protocol, "tls" | "quic");
    for side in ["listen", "connect"] {
        let mut all = Vec::new();
        collect(&settings[side]["endpoints"], &mut all);
        if let Some(plain) = all.iter().find(|e| !e.split('/').next().is_some_and(is_tls)) {
            return Err(format!(
                "TLS is set up by halves: there are certificates, and {side}.endpoints has '{plain}', which is in plain \
                 text: write tls/ADDRESS:PORT"
            ));
        }
    }
    let protocols = &mut settings["transport"]["link"]["protocols"];
    match protocols.as_array() {
        None => *protocols = json!(["tls"]),
        Some(all) => {
            if let Some(plain) = all.iter().filter_map(Value::as_str).find(|p| !is_tls(p)) {
                return Err(format!(
                    "TLS is set up by halves: there are certificates, and transport.link.protocols lets '{plain}' \
                     through, which is in plain text: write [\"tls\"]"
                ));
            }
        }
    }
    Ok(())
}

/// True when a setting has a value.
fn is_given(value: Option<&Value>) -> bool {
    match value {
        None | Some(Value::Null | Value::Bool(false)) => false,
        Some(Value::Object(map)) => map.values().any(|v| is_given(Some(v))),
        Some(_) => true,
    }
}

/// All endpoints in a list, or in one list for each mode.
fn collect(value: &Value, into: &mut Vec<String>) {
    match value {
        Value::String(endpoint) => into.push(endpoint.clone()),
        Value::Array(list) => list.iter().for_each(|v| collect(v, into)),
        Value::Object(map) => map.values().for_each(|v| collect(v, into)),
        _ => {}
    }
}

/// Objects are merged key by key; anything else is replaced.
fn merge(into: &mut Value, from: Value) {
    match (into, from) {
        (Value::Object(into), Value::Object(from)) => {
            for (key, value) in from {
                merge(into.entry(key).or_insert(Value::Null), value);
            }
        }
        (into, from) => *into = from,
    }
}

/// Replaces port 0 of TCP endpoints by a free port, so that this node can announce where it listens. Returns
/// all endpoints, and whether a port was chosen here.
pub(crate) fn fix_ports(settings: &mut Value) -> Result<(Vec<String>, bool), std::io::Error> {
    let mut chosen = false;
    let mut endpoints = Vec::new();
    let Some(list) = settings["listen"]["endpoints"].as_array_mut() else { return Ok((endpoints, chosen)) };
    // Kept bound until all are chosen, so that no port is chosen twice.
    let mut held = Vec::new();
    for endpoint in list {
        let Some(text) = endpoint.as_str() else { continue };
        let (address, options) = text.split_at(text.find(['?', '#']).unwrap_or(text.len()));
        let host = ["tcp/", "tls/"].iter().find_map(|p| address.strip_prefix(p)?.strip_suffix(":0"));
        let fixed = match host {
            Some(host) => {
                let listener = TcpListener::bind(format!("{host}:0"))?;
                let port = listener.local_addr()?.port();
                held.push(listener);
                chosen = true;
                format!("{}:{port}{options}", &address[..address.len() - ":0".len()])
            }
            None => text.to_string(),
        };
        *endpoint = Value::String(fixed.clone());
        endpoints.push(fixed);
    }
    Ok((endpoints, chosen))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The configuration after the checks, or the reason for its refusal.
    fn checked(user: Value) -> Result<Value, String> {
        let mut settings = defaults(Duration::ZERO);
        merge(&mut settings, user);
        check_tls(&mut settings).map(|()| settings)
    }

    fn tls(tls: Value, listen: &str) -> Value {
        json!({ "listen": { "endpoints": [listen] }, "transport": { "link": { "tls": tls } } })
    }

    #[test]
    fn tls_by_halves_is_refused_and_what_is_missing_is_named() {
        let whole = json!({ "listen_certificate": "c.pem", "listen_private_key": "c.key" });
        let open = "tls/127.0.0.1:0";
        let cases = [
            (tls(whole.clone(), "tcp/127.0.0.1:0"), "listen.endpoints has 'tcp/127.0.0.1:0'"),
            (json!({ "transport": { "link": { "tls": whole } } }), "listen.endpoints has 'tcp/127.0.0.1:0'"),
            (tls(json!({ "listen_certificate": "c.pem" }), open), "listen_private_key is missing"),
            (tls(json!({ "connect_private_key_base64": "k" }), open), "connect_certificate is missing"),
            (tls(json!({ "enable_mtls": true }), open), "root_ca_certificate is missing"),
            (json!({ "transport": { "auth": { "usrpwd": { "user": "u" } } } }), "transport.auth.usrpwd"),
        ];
        for (user, said) in cases {
            let error = checked(user.clone()).expect_err(&user.to_string());
            assert!(error.contains(said), "{user}: {error}");
        }
        let mut user = tls(whole.clone(), open);
        user["transport"]["link"]["protocols"] = json!(["tls", "tcp"]);
        assert!(checked(user).unwrap_err().contains("'tcp'"));
        let mut user = tls(whole.clone(), open);
        user["connect"] = json!({ "endpoints": { "peer": ["udp/192.0.2.1:7447"] } });
        assert!(checked(user).unwrap_err().contains("udp/192.0.2.1:7447"));
        let good = checked(tls(whole, open)).unwrap();
        assert_eq!(good["transport"]["link"]["protocols"], json!(["tls"]), "nothing else is let through");
        checked(json!({})).unwrap();
    }

    #[test]
    fn protection_leaves_no_link_without_it() {
        let identity = crate::Identity { authority: "a".into(), certificate: "c".into(), key: "k".into() };
        let mut bus = BusConfig::new("lab", "plant", crate::Transport::Zenoh);
        bus.zenoh.protection = Some(Protection { identity, members: Vec::new() });
        bus.zenoh.connect = vec!["tcp/127.0.0.1:7447".into()];
        let settings = settings(&bus).unwrap();
        assert_eq!(settings["listen"]["endpoints"], json!(["tls/127.0.0.1:0"]));
        assert_eq!(settings["connect"]["endpoints"], json!(["tls/127.0.0.1:7447"]));
        assert_eq!(settings["transport"]["link"]["protocols"], json!(["tls"]));
        assert_eq!(settings["access_control"]["default_permission"], "deny");
        let opened = crate::Bus::open(&bus).err();
        assert!(
            matches!(opened, Some(OpenError::TwoThreads { .. })),
            "this process has no ZENOH_RUNTIME: {opened:?}"
        );
        bus.zenoh.connect = vec!["udp/127.0.0.1:7447".into()];
        let error = super::settings(&bus).unwrap_err().to_string();
        assert!(error.contains("udp/127.0.0.1:7447") && error.contains("mode = \"open\""), "{error}");
    }
}
