//! The keys `listen`, `listen_hosts`, `listen_origins` and `listen_token`, for network clients.

use super::problem::{KeyError, Problem};
use meissner_input::message::quote;
use std::net::SocketAddr;

/// Where the daemon listens for network clients, and which it admits.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listen {
    /// Address and port.
    pub address: SocketAddr,
    /// Names by which clients may call this machine, besides its addresses and `localhost`.
    pub hosts: Vec<String>,
    /// Sites whose pages may send requests, as the browser names them: `https://lab.example`.
    pub origins: Vec<String>,
    /// Clients on this machine need a token, too.
    pub always_token: bool,
}

/// Reads the keys of the network.
pub(super) fn check(
    address: Option<&str>,
    hosts: Option<Vec<String>>,
    origins: Option<Vec<String>>,
    token: Option<&str>,
) -> Result<Option<Listen>, KeyError> {
    let found = address.unwrap_or("none");
    let bad = |_| KeyError::key("listen", Problem::Listen { found: quote(found) });
    let address: Option<SocketAddr> = if found == "none" { None } else { Some(found.parse().map_err(bad)?) };
    if address.is_some_and(|address| address.port() == u16::MAX) {
        return Err(KeyError::key("listen", Problem::LastPort { found: quote(found) }));
    }
    let hosts = hosts.unwrap_or_default();
    let plain = |name: &str| {
        let good = |byte: u8| byte.is_ascii_alphanumeric() || b"-._".contains(&byte);
        (1..=253).contains(&name.len()) && name.bytes().all(good) && !name.ends_with('.')
    };
    if let Some(bad) = hosts.iter().find(|name| !plain(name)) {
        return Err(KeyError::key("listen_hosts", Problem::Host { found: quote(bad) }));
    }
    let origins = origins.unwrap_or_default();
    let is_origin = |origin: &&String| {
        let site = origin.strip_prefix("https://").or_else(|| origin.strip_prefix("http://"));
        let good = |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b"-._:[]".contains(&byte);
        site.is_some_and(|site| (1..=253).contains(&site.len()) && site.bytes().all(good))
    };
    if let Some(bad) = origins.iter().find(|origin| !is_origin(origin)) {
        return Err(KeyError::key("listen_origins", Problem::Origin { found: quote(bad) }));
    }
    let always_token = match token.unwrap_or("remote") {
        "remote" => false,
        "always" => true,
        other => return Err(KeyError::key("listen_token", Problem::ListenToken { found: quote(other) })),
    };
    Ok(address.map(|address| Listen { address, hosts, origins, always_token }))
}

#[cfg(test)]
mod tests {
    use crate::config::{Config, Source};
    use std::path::Path;

    #[test]
    fn the_network_is_off_unless_an_address_is_given() {
        let parse = |text: &str| Config::parse(text, Path::new("m.toml")).map_err(|error| error.to_string());
        for off in ["", "listen = \"none\"\nlisten_token = \"always\""] {
            assert_eq!(parse(off).unwrap().listen, None);
        }
        let listen = parse("listen = \"[::1]:80\"\nlisten_hosts = [\"a.b\"]\nlisten_token = \"always\"")
            .unwrap()
            .listen
            .unwrap();
        assert_eq!(
            (listen.address.to_string().as_str(), &*listen.hosts, listen.always_token),
            ("[::1]:80", &["a.b".to_owned()][..], true)
        );
        for (bad, line) in [
            (
                "listen = \"8765\"",
                "`listen` is `8765`: must be an address and a port, as \"127.0.0.1:8765\", or \"none\"",
            ),
            ("listen = \"[::]:65535\"", "`listen` is `[::]:65535`: emergency stops take the port after it"),
            ("listen = \"localhost:8765\"", "`listen` is `localhost:8765`: must be an address and a port"),
            (
                "listen_hosts = [\"a.b:80\"]",
                "`listen_hosts` is `a.b:80`: must be a host's name, without port and path",
            ),
            ("listen_hosts = [\"\"]", "`listen_hosts` is ``: must be a host's name"),
            (
                "listen_origins = [\"https://lab.example/study\"]",
                "`listen_origins` is `https://lab.example/study`: must be a site, as \"https://lab.example\"",
            ),
            ("listen_origins = [\"*\"]", "`listen_origins` is `*`: must be a site"),
            ("listen_origins = [\"null\"]", "`listen_origins` is `null`: must be a site"),
            ("listen_token = \"never\"", "`listen_token` is `never`: must be \"remote\" or \"always\""),
        ] {
            let found = parse(bad).unwrap_err();
            assert!(found.contains(line), "{found}");
        }
    }

    #[test]
    fn the_commands_address_keeps_the_files_other_keys() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("m.toml");
        let address = "127.0.0.1:8765".parse().unwrap();
        for off in ["", "listen = \"none\"\n", "listen = \"[::1]:80\"\n"] {
            std::fs::write(&file, format!("{off}listen_hosts = [\"a.b\"]\nlisten_token = \"always\""))
                .unwrap();
            let source = Source { file: Some(file.clone()), listen: Some(address), ..Source::default() };
            let listen = source.read().unwrap().listen.unwrap();
            assert!(
                listen.address == address && listen.always_token && listen.hosts == ["a.b"],
                "{listen:?}"
            );
        }
        let listen = Source { listen: Some(address), ..Source::default() }.read().unwrap().listen.unwrap();
        assert!(listen.address == address && !listen.always_token && listen.hosts.is_empty(), "{listen:?}");
    }
}
