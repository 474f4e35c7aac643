//! The doctor's finding if no daemon answers.
//!
//! Invariant: a daemon that does not answer is a finding, not an error.

use meissner_api::Finding;
use meissner_client::ClientError;

/// The finding about a request for the status that failed.
pub(super) fn finding(error: ClientError) -> Finding {
    match error {
        ClientError::NoDaemon { endpoint, .. } => {
            let advice = format!("to play, {}, or name its socket with --socket", endpoint.how_to_start());
            Finding::warn("daemon", format!("no daemon answers at {endpoint}"), advice)
        }
        ClientError::Denied { socket, found, advice } => {
            Finding::fail("daemon", format!("a daemon listens at {}, but {found}", socket.display()), advice)
        }
        error => Finding::fail("daemon", error.to_string(), "read the daemon's log"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;
    use meissner_client::Place;

    #[test]
    fn a_daemon_that_does_not_answer_is_a_finding() {
        let line = |error| fake::line(&finding(error));
        let endpoint = meissner_client::Endpoint {
            place: Place::Socket("/a".into()),
            fallback: Some(Place::Socket("/b".into())),
            service_installed: true,
        };
        let source = std::io::ErrorKind::NotFound.into();
        assert_eq!(
            line(ClientError::NoDaemon { endpoint, source }),
            "Warn daemon: no daemon answers at /a, nor at /b -> to play, `sudo systemctl start meissner`, or start one with \
             `meissner daemon`, or name its socket with --socket"
        );
        let (found, advice) = ("you are not in it".to_owned(), "`join`".to_owned());
        assert_eq!(
            line(ClientError::Denied { socket: "/a".into(), found, advice }),
            "Fail daemon: a daemon listens at /a, but you are not in it -> `join`"
        );
    }
}
