//! Access control of the web server.
//!
//! On loopback every page in the user's browser could send requests to this server. Therefore the host of a
//! request must be this machine (against names that resolve to it), and a control must come from the page itself.
//! From other machines the token is required.

use axum::http::{HeaderMap, Uri, header};

/// The rules of access to a page and its controls.
#[derive(Debug, Clone)]
pub(crate) struct Access {
    /// The token that a request from another machine must contain.
    pub token: Option<String>,
}

impl Access {
    /// Whether a request may see the page.
    pub fn may_look(&self, uri: &Uri, headers: &HeaderMap) -> bool {
        match &self.token {
            Some(token) => given_token(uri).is_some_and(|given| same(given, token)),
            None => host(headers).is_some_and(is_this_machine),
        }
    }

    /// Whether a request for a change comes from the page itself, or from a program that is no browser.
    pub fn may_control(&self, uri: &Uri, headers: &HeaderMap) -> bool {
        let is_json = text(headers, header::CONTENT_TYPE).is_some_and(|t| t.starts_with("application/json"));
        let origin = text(headers, header::ORIGIN);
        let own = origin.is_none_or(|o| o.split_once("://").map(|(_, authority)| authority) == host(headers));
        is_json && own && self.may_look(uri, headers)
    }
}

fn text(headers: &HeaderMap, name: header::HeaderName) -> Option<&str> {
    headers.get(name)?.to_str().ok()
}

fn host(headers: &HeaderMap) -> Option<&str> {
    text(headers, header::HOST)
}

fn is_this_machine(host: &str) -> bool {
    let name = match host.strip_prefix('[') {
        Some(rest) => rest.split(']').next().unwrap_or(""),
        None => host.split(':').next().unwrap_or(""),
    };
    name == "localhost" || name.parse::<std::net::IpAddr>().is_ok_and(|ip| ip.is_loopback())
}

fn given_token(uri: &Uri) -> Option<&str> {
    uri.query()?.split('&').find_map(|pair| pair.strip_prefix("token="))
}

/// Compares two texts in a time that does not depend on where they differ.
fn same(given: &str, token: &str) -> bool {
    let differs = given.bytes().zip(token.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
    given.len() == token.len() && differs == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&'static str, &'static str)]) -> HeaderMap {
        pairs.iter().map(|(name, value)| (name.parse().unwrap(), value.parse().unwrap())).collect()
    }

    #[test]
    fn a_foreign_page_and_a_borrowed_name_are_refused_on_loopback() {
        let access = Access { token: None };
        let uri: Uri = "/control".parse().unwrap();
        let host = ("host", "127.0.0.1:8480");
        let json = ("content-type", "application/json");
        let control = |more: &[_]| access.may_control(&uri, &headers(&[&[host], more].concat()));
        assert!(control(&[json]));
        assert!(control(&[json, ("origin", "http://127.0.0.1:8480")]));
        assert!(!control(&[json, ("origin", "http://example.com")]));
        assert!(!control(&[("content-type", "text/plain")]), "a form of another page needs no permission");
        for (name, lets_in) in
            [("localhost:1", true), ("[::1]:80", true), ("example.com", false), ("10.0.0.1", false)]
        {
            assert_eq!(access.may_look(&uri, &headers(&[("host", name)])), lets_in, "{name}");
        }
    }

    #[test]
    fn from_another_machine_the_token_is_needed() {
        let access = Access { token: Some("abc".into()) };
        let look = |uri: &str| access.may_look(&uri.parse().unwrap(), &headers(&[("host", "192.0.2.2")]));
        assert!(look("/?token=abc") && look("/events?x=1&token=abc"));
        assert!(!look("/") && !look("/?token=ab") && !look("/?token=abd") && !look("/?token=abcd"));
    }
}
