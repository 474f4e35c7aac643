//! Calls that wait for their answer: [`Client`].

use crate::connection::{ANSWER_TIMEOUT, Connection, Tokens, connect, hung_up, read_all, refused, request};
use crate::endpoint::{Endpoint, Place};
use crate::error::ClientError;
use crate::events::Events;
use hyper::Method;
use hyper::body::Bytes;
use meissner_api::{Order, PlanCheck, PlayAccepted, Problem, Status};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::env;
use std::path::Path;
use std::time::Duration;
use tokio::runtime::{Builder, Runtime};

/// How long to wait for `POST /v1/home`. The daemon answers earlier: as soon as its array must have come home.
pub const HOME_TIMEOUT: Duration = Duration::from_secs(600);
/// Timeout of [`Client::play`] and [`Client::check`]: the daemon compiles the whole play before it answers.
const COMPILE_TIMEOUT: Duration = Duration::from_secs(60);
/// Timeout of [`Client::put`], [`Client::delete`], and what else waits for the daemon's disk, which may be slow: the session record, and
/// a new token.
pub const DISK_TIMEOUT: Duration = Duration::from_secs(60);

/// A client of one daemon.
#[derive(Debug)]
pub struct Client {
    endpoint: Endpoint,
    runtime: Runtime,
    connection: Option<Connection>,
    tokens: Tokens,
    patience: Duration,
}

impl Client {
    /// A client of the daemon at `socket`. It connects at the first call, and again if the daemon has closed the connection.
    ///
    /// # Errors
    /// [`ClientError::Runtime`].
    pub fn new(socket: &Path) -> Result<Self, ClientError> {
        Self::at(Endpoint::at(socket))
    }

    /// A client of the first daemon that listens at this endpoint. On the network it shows the access token in `$MEISSNER_TOKEN`, if that is
    /// set.
    ///
    /// # Errors
    /// [`ClientError::Runtime`].
    pub fn at(endpoint: Endpoint) -> Result<Self, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let access = match endpoint.place {
            Place::Network(_) => env::var("MEISSNER_TOKEN").ok().filter(|token| !token.is_empty()),
            Place::Socket(_) => None,
        };
        Ok(Self {
            endpoint,
            runtime,
            connection: None,
            tokens: Tokens { access, session: None },
            patience: Duration::ZERO,
        })
    }

    /// Sends this token of a session with every request, or none. It shows the daemon that the session's owner is there.
    pub fn set_token(&mut self, token: Option<String>) {
        self.tokens.session = token;
    }

    /// Waits for each answer at least this long, as tests do on a machine that stands still for seconds.
    pub fn set_patience(&mut self, patience: Duration) {
        self.patience = patience;
    }

    /// Sends a `GET` and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn get<T: DeserializeOwned>(&mut self, path: &str) -> Result<T, ClientError> {
        self.get_within(ANSWER_TIMEOUT, path)
    }

    /// [`Self::get`] with another timeout: for `/v1/plays/ID?wait=S`, which answers after up to S seconds.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn get_within<T: DeserializeOwned>(
        &mut self,
        timeout: Duration,
        path: &str,
    ) -> Result<T, ClientError> {
        self.call(Method::GET, path, Bytes::new(), timeout)
    }

    /// Sends a `POST` with a JSON body and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post<T: DeserializeOwned>(&mut self, path: &str, body: &impl Serialize) -> Result<T, ClientError> {
        self.post_within(ANSWER_TIMEOUT, path, body)
    }

    /// [`Self::post`] with another timeout.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn post_within<T: DeserializeOwned>(
        &mut self,
        timeout: Duration,
        path: &str,
        body: &impl Serialize,
    ) -> Result<T, ClientError> {
        let body = serde_json::to_vec(body).map_err(|error| self.bad_answer(&error))?;
        self.call(Method::POST, path, body.into(), timeout)
    }

    /// Sends an emergency stop; its body is the access token, which the port for emergency stops reads there.
    pub(crate) fn estop(&mut self) -> Result<Status, ClientError> {
        let token = self.tokens.access.clone().unwrap_or_default();
        self.call(Method::POST, "/v1/estop", token.into(), ANSWER_TIMEOUT)
    }

    /// Sends a `PUT` with a text and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn put<T: DeserializeOwned>(&mut self, path: &str, text: String) -> Result<T, ClientError> {
        self.call(Method::PUT, path, text.into(), DISK_TIMEOUT)
    }

    /// Sends a `DELETE` and reads the JSON answer.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn delete<T: DeserializeOwned>(&mut self, path: &str) -> Result<T, ClientError> {
        self.call(Method::DELETE, path, Bytes::new(), DISK_TIMEOUT)
    }

    fn call<T: DeserializeOwned>(
        &mut self,
        method: Method,
        path: &str,
        body: Bytes,
        timeout: Duration,
    ) -> Result<T, ClientError> {
        let timeout = timeout.max(self.patience);
        let idle = self.connection.is_some();
        let mut answer = self.exchange(&method, path, &body, timeout);
        // The daemon may have closed the idle connection just now. A `GET` changes nothing, so it is sent again.
        if idle && method == Method::GET && matches!(answer, Err(ClientError::HungUp { .. })) {
            answer = self.exchange(&method, path, &body, timeout);
        }
        let (good, bytes) = answer?;
        if good {
            return serde_json::from_slice(&bytes).map_err(|error| self.bad_answer(&error));
        }
        Err(serde_json::from_slice::<Problem>(&bytes)
            .map_or_else(|error| self.bad_answer(&error), Into::into))
    }

    /// Whether a connection is open, and the daemon has not closed it.
    #[cfg(test)]
    pub(crate) fn is_connected(&self) -> bool {
        self.connection.as_ref().is_some_and(Connection::is_open)
    }

    /// Sends one request; returns whether it succeeded, and the answer's body.
    fn exchange(
        &mut self,
        method: &Method,
        path: &str,
        body: &Bytes,
        timeout: Duration,
    ) -> Result<(bool, Bytes), ClientError> {
        let Self { endpoint, runtime, connection, tokens, .. } = self;
        let answer = runtime.block_on(async {
            let exchange = async {
                // The daemon closes a connection that was idle for 10 minutes, or that another client needs.
                if !connection.as_ref().is_some_and(Connection::is_open) {
                    let (found, place) = connect(endpoint).await?;
                    *connection = Some(found);
                    // Later calls use the same daemon, even if another one starts.
                    *endpoint = endpoint.only(&place);
                }
                let place = &endpoint.place;
                let Some(Connection { sender, .. }) = connection else { return Err(hung_up(place, None)) };
                sender.ready().await.map_err(|source| hung_up(place, Some(source)))?;
                let request = request(method.clone(), path, body.clone(), place, tokens);
                let response = sender.send_request(request).await;
                read_all(place, response.map_err(|source| hung_up(place, Some(source)))?).await
            };
            let answer = tokio::time::timeout(timeout, exchange).await;
            answer.unwrap_or_else(|_| Err(ClientError::Timeout { place: endpoint.place.clone(), timeout }))
        });
        if answer.is_err() {
            self.connection = None;
        }
        answer
    }

    fn bad_answer(&self, error: &serde_json::Error) -> ClientError {
        ClientError::BadAnswer { place: self.endpoint.place.clone(), what: error.to_string() }
    }

    /// Orders a play. The answer comes once the daemon has compiled and accepted it; a client that ends before takes the order back.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn play(&mut self, order: &Order) -> Result<PlayAccepted, ClientError> {
        self.post_within(COMPILE_TIMEOUT, "/v1/play", order)
    }

    /// Asks whether a play would stop at the drift limit on a board.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn check(&mut self, order: &Order) -> Result<PlanCheck, ClientError> {
        self.post_within(COMPILE_TIMEOUT, "/v1/play/check", order)
    }

    /// Listens to events on a separate connection. It gets all events that happen after this call returns.
    ///
    /// # Errors
    /// See [`ClientError`].
    pub fn events(&self) -> Result<Events, ClientError> {
        let runtime = Builder::new_current_thread().enable_all().build().map_err(ClientError::Runtime)?;
        let (place, response) = runtime.block_on(async {
            let (Connection { mut sender, .. }, place) = connect(&self.endpoint).await?;
            let request = request(Method::GET, "/v1/events", Bytes::new(), &place, &self.tokens);
            let slow = |_| Err(ClientError::Timeout { place: place.clone(), timeout: ANSWER_TIMEOUT });
            let response = async {
                let response = sender.send_request(request).await;
                let response = response.map_err(|source| hung_up(&place, Some(source)))?;
                if response.status().is_success() {
                    return Ok(response);
                }
                Err(refused(&place, response).await)
            };
            let response = tokio::time::timeout(ANSWER_TIMEOUT, response).await.unwrap_or_else(slow)?;
            Ok::<_, ClientError>((place, response))
        })?;
        Ok(Events::new(place, runtime, response.into_body()))
    }
}
