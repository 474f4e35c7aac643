//! Routes: every address of the API is one row, with its method, who may use it, its handler, body and answer.
//!
//! The daemon's router and gate, its log and [`crate::openapi`] come from the rows, so they cannot name different routes. A new route is a row
//! here, and its handler.

use crate::access::{Access, SessionRule};
use crate::order::MAX_WAIT_S;
use crate::rendering::{MAX_PREVIEW_FROM_S, MAX_PREVIEW_S};
use crate::token::Role;

/// An HTTP method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[expect(missing_docs, reason = "their names say it")]
pub enum Method {
    Get,
    Post,
    Put,
    Delete,
}

/// What a route takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Body {
    /// Nothing.
    None,
    /// Nothing, or `{}`.
    Empty,
    /// A JSON object of this schema.
    Json(&'static str),
    /// A JSON object of this schema; without a body, every default.
    OptionalJson(&'static str),
    /// A pattern file.
    Toml,
    /// A calibration file.
    Calibration,
}

/// What a route answers with on success.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A JSON object of this schema.
    Json(&'static str),
    /// Server-sent events, each of the schema `Event`.
    Events,
    /// A text of this media type, with an example.
    Text(&'static str, &'static str),
    /// The OpenAPI document.
    OpenApi,
}

/// A query parameter of a route.
#[derive(Clone, Copy, Debug)]
pub enum Query {
    /// A number, 0 or more.
    Number {
        /// The parameter's name.
        name: &'static str,
        /// The greatest value.
        most: f64,
        /// What it means.
        about: &'static str,
    },
    /// A SHA-256 in hexadecimal.
    Sha256 {
        /// The parameter's name.
        name: &'static str,
        /// What it means.
        about: &'static str,
    },
    /// `true`, or by default `false`.
    Flag {
        /// The parameter's name.
        name: &'static str,
        /// What it means.
        about: &'static str,
    },
}

/// The row of a route.
#[derive(Clone, Copy, Debug)]
pub struct Operation {
    /// The HTTP method.
    pub method: Method,
    /// The name of its command in the log and the session record.
    pub command: &'static str,
    /// What a client needs for it.
    pub access: Access,
    /// Whether its client is asked for its right again while it waits. Other requests are asked again when they make their change.
    pub waits: bool,
    /// Whether a long answer may be compressed. One that makes the display safe, or has no end, passes as it is.
    pub packed: bool,
    /// The address; `{name}` and `{id}` stand for a part of it.
    pub path: &'static str,
    /// What the route does, in the imperative.
    pub summary: &'static str,
    /// When it answers, and what else a caller has to know.
    pub description: &'static str,
    /// What the path's variable part means.
    pub parameter: Option<&'static str>,
    /// Its query parameters.
    pub queries: &'static [Query],
    /// What it takes.
    pub body: Body,
    /// HTTP statuses of success, each with its meaning.
    pub statuses: &'static [(u16, &'static str)],
    /// What it answers with.
    pub answer: Answer,
}

const OK: &[(u16, &str)] = &[(200, "Done")];
const ACCEPTED: &[(u16, &str)] = &[(202, "Queued")];
const STATUS: Answer = Answer::Json("Status");

impl Route {
    /// The HTTP method.
    pub const fn method(self) -> Method {
        self.operation().method
    }

    /// The address.
    pub const fn path(self) -> &'static str {
        self.operation().path
    }

    /// What a client needs for it.
    pub const fn access(self) -> Access {
        self.operation().access
    }
}

impl Operation {
    /// A command without arguments that answers with the status.
    const fn post(path: &'static str) -> Self {
        Self {
            method: Method::Post,
            access: Access::CHANGES,
            waits: false,
            body: Body::Empty,
            ..Self::get(path)
        }
    }

    const fn put(path: &'static str) -> Self {
        Self { method: Method::Put, ..Self::delete(path) }
    }

    const fn delete(path: &'static str) -> Self {
        Self { method: Method::Delete, body: Body::None, ..Self::post(path) }
    }

    const fn get(path: &'static str) -> Self {
        Self {
            method: Method::Get,
            command: "read",
            access: Access::READS,
            waits: true,
            packed: true,
            path,
            summary: "",
            description: "",
            parameter: None,
            queries: &[],
            body: Body::None,
            statuses: OK,
            answer: STATUS,
        }
    }
}

/// Takes the rows: a route, its handler in the daemon, and its operation. `$d` is a dollar sign.
macro_rules! routes {
    (($d:tt) $($route:ident => $handler:path, $operation:expr;)*) => {
        /// The routes, in the order of the API reference.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        #[expect(missing_docs, reason = "`operation` describes each")]
        pub enum Route {
            $($route),*
        }

        impl Route {
            /// Every route.
            pub const ALL: [Self; [$(stringify!($route)),*].len()] = [$(Self::$route),*];

            /// Its row.
            pub const fn operation(self) -> Operation {
                match self {
                    $(Self::$route => $operation),*
                }
            }
        }

        /// The handler of a route: a match whose arms pass it to the macro `$on`, for the daemon.
        #[macro_export]
        macro_rules! handler {
            ($d route:expr, $d on:ident) => {
                match $d route {
                    $($d crate::Route::$route => $d on!($handler)),*
                }
            };
        }
    };
}

routes! {
    ($)
    Play => plays::handlers::play, Operation {
        command: "play",
        summary: "Queue a play: of one pattern, or of many items with exact times",
        description: "The daemon answers when the streamer has taken the play. The receipt and the events `queued`, \
                      `began`, `late`, `refused` and `ended` report what happens to it. At most 16 plays wait. The \
                      body has at most 4096 items and 1 MiB, or 80 MiB with packed samples; one such body is in work at a time. The samples \
                      of all plays that are not over take at most 128 MiB of memory. All of it is accepted or refused: every \
                      pattern exists, every item but a blank one has a stroke or a motion, of several items each has an end, items begin at least 5 ms apart, those \
                      that overlap drive different motors, and no trigger ends another. The patterns have at most \
                      4096 drives and motors with motions together, counted once for each scale. A stop or `replace` ends the whole play.",
        body: Body::Json("Order"),
        statuses: ACCEPTED,
        answer: Answer::Json("PlayAccepted"),
        ..Operation::post("/v1/play")
    };
    PlayCheck => plays::handlers::check, Operation {
        access: Access::READS,
        summary: "Tell whether a play would stop at the drift limit on a board",
        description: "Nothing is played, and no device is needed. The daemon compiles the order as `POST /v1/play` does, and \
                      follows the estimate of the drift of a device without telemetry, from level pins on: with the lower stop, the \
                      limit and the calibration that are in use. A study of many plays is one order of all its plays. \
                      It follows ten million strokes. One check is computed at a time, with low priority, and three \
                      more wait: a further one is `busy`.",
        body: Body::Json("Order"),
        statuses: OK,
        answer: Answer::Json("PlanCheck"),
        ..Operation::post("/v1/play/check")
    };
    Live => live::handlers::start, Operation {
        command: "live",
        summary: "Start a live play, whose drives change while it runs",
        description: "The daemon answers when the streamer has taken the play. Its client then opens the connection at `path` \
                      and sends updates, the first within 2 s. The play ends when the client ends it, closes the connection \
                      or is silent for `timeout_ms`: the pins return. It cannot be queued, nor another play behind it.",
        body: Body::Json("LiveRequest"),
        statuses: ACCEPTED,
        answer: Answer::Json("LiveAccepted"),
        ..Operation::post("/v1/live")
    };
    LiveConnection => live::handlers::connect, Operation {
        // It opens what orders motion.
        access: Access::CHANGES,
        packed: false,
        summary: "Open the connection of a live play",
        description: "An upgrade of the connection to `websocket`. The client sends messages of the schema `LiveMessage`, and the daemon answers each with one of the \
                      schema `LiveAnswer`: `applied` once the device has it, with the tick from which each motor has its new \
                      drive. An update replaces the strokes of the motors that it changes, each from its next period \
                      on: no stroke is cut. Of messages that come faster than the device takes them the newest wins, and \
                      the others are `merged_into` it. A message without `drives` and `scale` shows that the client is there.",
        parameter: Some("The key of the answer to `POST /v1/live`"),
        statuses: &[(101, "The connection speaks the new protocol")],
        answer: Answer::Json("LiveAnswer"),
        ..Operation::get("/v1/live/{key}")
    };
    Stop => arm::handlers::stop, Operation {
        command: "stop",
        access: Access::MAKES_SAFE,
        packed: false,
        summary: "Stop the running play and clear the queue",
        description: "The device returns the pins to rest. The motors stay armed. Everybody who may operate may order it, also \
                      during an exclusive session of another client; the event `intervened` then tells its owner.",
        ..Operation::post("/v1/stop")
    };
    EStop => arm::handlers::estop, Operation {
        command: "estop",
        // An observer who sees a hurt finger must be able to stop.
        access: Access { role: Role::Observe, ..Access::MAKES_SAFE },
        packed: false,
        summary: "Stop at once, switch the motors off and latch the fault",
        description: "Prefer `SOCKET.estop`, or over TCP the same request with the access token as its body on the port after \
                      this one: a real-time thread serves them, and they wait for no other client. Clients send both at once. The daemon \
                      acts before it reads the body, and passes the command on even if its queue is full or it shuts down. It answers when the device has confirmed that all lines are off; \
                      `estop.off_ms` in the status says how long after the order that was. `POST /v1/reset` clears the latch.",
        body: Body::None,
        ..Operation::post("/v1/estop")
    };
    Reset => arm::handlers::reset, Operation {
        command: "reset",
        summary: "Clear a latched emergency stop or fault",
        description: "Pins that stand above rest (`standing` in the status) return to it, unless `keep` says that they must not \
                      move; then the answer comes. The motors stay disarmed. If another terminal has ordered an emergency stop since the last reset, a person \
                      must confirm with `force`. A client is a process, or the commands of one terminal session.",
        body: Body::OptionalJson("ResetRequest"),
        ..Operation::post("/v1/reset")
    };
    Arm => arm::handlers::arm, Operation {
        command: "arm",
        summary: "Enable the motors",
        description: "A device that knows where its pins are first returns those that stand above rest. Another one needs `assume_rest`, \
                      which takes every pin as at rest, and with `checked` ends what the device knows. If a \
                      pin may have drifted or stand by more than 20 µm in all, `assume_rest` needs `checked`: who has looked at the \
                      pins; but not if telemetry showed all pins until the motors were disarmed. The client states with `silence_s` or \
                      `unattended` whether the motors may stay armed without it; `armed` in the status shows what is left.",
        body: Body::OptionalJson("ArmRequest"),
        ..Operation::post("/v1/arm")
    };
    Disarm => arm::handlers::disarm, Operation {
        command: "disarm",
        access: Access::MAKES_SAFE,
        packed: false,
        summary: "Stop, return the pins to rest and switch the motors off",
        description: "It takes precedence over commands that wait; those end with `returning`. Everybody who may operate may \
                      order it, as for `POST /v1/stop`. A client that ends takes back only what it has armed with `own`: \
                      motors that another client has armed, too, stay armed for that one.",
        body: Body::OptionalJson("DisarmRequest"),
        ..Operation::post("/v1/disarm")
    };
    Home => arm::handlers::home, Operation {
        command: "home",
        waits: true,
        summary: "Move every pin to rest",
        description: "The daemon answers when the pins are at rest, after up to 25 s. The motors must be armed, and no play \
                      queued. Without telemetry it moves each pin once, by the drift it expects.",
        ..Operation::post("/v1/home")
    };
    Edge => arm::handlers::edge, Operation {
        command: "edge",
        summary: "Make an edge at the trigger input of a simulated array",
        description: "For tests and pilots: it does what a pulse at the trigger input of a board does. A board refuses it. The event \
                      `edge` tells of each edge. An edge to come is withdrawn when its client loses the right to order it.",
        body: Body::OptionalJson("EdgeRequest"),
        ..Operation::post("/v1/edge")
    };
    Status => status::handlers::status, Operation {
        summary: "Show the device, the running play, the queue and the motors",
        description: "All parts belong to one instant.",
        answer: STATUS,
        ..Operation::get("/v1/status")
    };
    Heights => status::handlers::heights, Operation {
        summary: "Show what each pin did in the last 250 ms",
        description: "To draw the pins, whatever moves them: a client that asks every 100 ms for what came since the `tick` of the answer \
                      before gets all of it. The newest height is at most 50 ms old. What a stop did is exact once the device has \
                      reported it, milliseconds later.",
        queries: &[Query::Number {
            name: "since_tick",
            most: 9_007_199_254_740_991.0,
            about: "The heights after this tick alone. If it is to come, the device has started again: all",
        }],
        answer: Answer::Json("PinHeights"),
        ..Operation::get("/v1/heights")
    };
    Array => status::handlers::array, Operation {
        summary: "Show the array: where its pins stand, its carrier, wiring and motors",
        description: "It is the description that the daemon was started with. It does not change while the daemon runs.",
        answer: Answer::Json("ArrayDetails"),
        ..Operation::get("/v1/array")
    };
    Doctor => status::handlers::doctor, Operation {
        summary: "Check what could keep the machine or its device from playing",
        description: "The findings of `meissner doctor` that the daemon can make from where it runs: about its machine, \
                      itself and its device. It measures, moves and changes nothing. A check takes up to 3 s, an \
                      answer up to 10 s: one check runs at a time, at most four in a second, and requests that come \
                      meanwhile share the next one. The command on the daemon's machine also measures timers, checks its \
                      user's rights, and can have a board test itself.",
        answer: Answer::Json("DoctorReport"),
        ..Operation::get("/v1/doctor")
    };
    Receipt => plays::handlers::receipt, Operation {
        summary: "Show the result of a play",
        description: "The daemon keeps every play that waits or runs, and the last 1000 that have ended. With `wait` it \
                      answers when the play has ended, or after that time with the receipt as it is then. At most \
                      48 clients wait or listen to events, so that commands find places.",
        parameter: Some("The play's id, or `last`"),
        queries: &[Query::Number {
            name: "wait",
            most: MAX_WAIT_S,
            about: "How long to wait for the play's end, s; without it the daemon answers at once",
        }],
        answer: Answer::Json("Receipt"),
        ..Operation::get("/v1/plays/{id}")
    };
    Withdraw => plays::handlers::withdraw, Operation {
        command: "withdraw",
        summary: "Take a waiting play out of the queue",
        description: "The other plays stay. A play that runs is refused: `POST /v1/stop` ends it, and all that wait. One that is over \
                      stays as it is.",
        parameter: Some("The play's id"),
        answer: Answer::Json("Receipt"),
        ..Operation::delete("/v1/plays/{id}")
    };
    PlayAnswer => plays::handlers::answer, Operation {
        command: "answer",
        summary: "Record a participant's answer to a play",
        description: "The play belongs to the running session, has begun, and is among the last 1000 that have ended. A play has at \
                      most one answer. The session record keeps it, and every export shows it in the row of the play; the \
                      items of a sequence repeat it. An answer whose line the disk refuses, or has not taken within 4 s, is an \
                      error (`store`): send it again.",
        parameter: Some("The play's id"),
        body: Body::Json("PlayAnswer"),
        answer: Answer::Json("AnswerTaken"),
        ..Operation::post("/v1/plays/{id}/answer")
    };
    Events => status::events::events, Operation {
        packed: false,
        summary: "Listen to events",
        description: "Server-sent events, without end: `event:` is the event's name, `data:` its JSON on one line. The first \
                      one is `state`. A listener that falls 1024 events behind gets `lagged` in their place; one that reads nothing \
                      for a minute is disconnected. At most 48 streams are open, so that commands find places.",
        answer: Answer::Events,
        ..Operation::get("/v1/events")
    };
    Patterns => patterns::handlers::list, Operation {
        summary: "List the patterns",
        description: "The built-in library and the pattern directory, which the daemon reads anew.",
        answer: Answer::Json("PatternList"),
        ..Operation::get("/v1/patterns")
    };
    Pattern => patterns::handlers::show, Operation {
        summary: "Show a pattern",
        description: "The pattern has the keys of its file.",
        parameter: Some("The pattern's name, or `rendering:ID` for the pattern of a rendering"),
        queries: &[Query::Sha256 {
            name: "sha256",
            about: "Which text of that name: the stored one's SHA-256, or that of a text that was played and is in the session \
                    record; without it the stored one",
        }],
        answer: Answer::Json("PatternDetails"),
        ..Operation::get("/v1/patterns/{name}")
    };
    Preview => jobs::previews::show, Operation {
        summary: "Show what pins and afferents do under a pattern",
        description: "The heights of the pins by the motor model, every millisecond, and the spikes of the finger that also judges \
                      renderings. A pattern is played once, on ideal motors of its own array; one without end goes on. A process like \
                      that of a rendering computes it, within 30 s (`timeout`), and ends when the client hangs up. One preview is computed at a time; 8 \
                      wait, and further ones are refused (`busy`). The pattern's file may have 4 MiB.",
        parameter: Some("The pattern's name, or `rendering:ID` for the pattern of a rendering"),
        queries: &[
            Query::Number {
                name: "from_s",
                most: MAX_PREVIEW_FROM_S,
                about: "The pattern's time from which it shows, s; without it 0",
            },
            Query::Number {
                name: "seconds",
                most: MAX_PREVIEW_S,
                about: "How much it shows, s, at least 0.001; without it 1",
            },
        ],
        answer: Answer::Json("PatternPreview"),
        ..Operation::get("/v1/patterns/{name}/preview")
    };
    Import => patterns::handlers::import, Operation {
        command: "import",
        summary: "Store a pattern",
        description: "The daemon checks the file and writes it to its pattern directory. With `?replace=true` it replaces an \
                      older one of that name, and tells its SHA-256; without, it refuses (`exists`). The file must bear the \
                      name of the address, have a stroke or a motion, and at most 1 MiB, or 80 MiB with packed samples. Four imports are in work at a time; further \
                      ones wait, for 10 s at most.",
        parameter: Some("The pattern's name"),
        queries: &[Query::Flag {
            name: "replace",
            about: "Whether to replace a pattern of that name; without it the daemon does not",
        }],
        body: Body::Toml,
        statuses: &[(201, "Stored under a new name"), (200, "Stored in place of an older pattern")],
        answer: Answer::Json("ImportedPattern"),
        ..Operation::put("/v1/patterns/{name}")
    };
    Remove => patterns::handlers::remove, Operation {
        summary: "Remove a pattern",
        description: "The daemon removes the file from its pattern directory. Patterns of the library stay. A play of the pattern \
                      that is queued or runs goes on.",
        parameter: Some("The pattern's name"),
        answer: Answer::Json("RemovedPattern"),
        ..Operation::delete("/v1/patterns/{name}")
    };
    RenderingStart => jobs::renderings::start, Operation {
        command: "render",
        summary: "Render an object",
        description: "One rendering runs at a time, in a process of its own with low priority and at most 256 MiB. The event \
                      `rendering` reports how it stands. Its pattern plays as `rendering:ID` as soon as the event says \
                      `found`; until the rendering is `done`, one finger judges it. The body has at most 4 MiB.",
        body: Body::Json("RenderingRequest"),
        statuses: &[(202, "Started")],
        answer: Answer::Json("Rendering"),
        ..Operation::post("/v1/renderings")
    };
    RenderingShow => jobs::renderings::show, Operation {
        summary: "Show a rendering",
        description: "The daemon keeps the one that runs and the last 4 that have ended.",
        parameter: Some("The rendering's id, or `last`"),
        answer: Answer::Json("Rendering"),
        ..Operation::get("/v1/renderings/{id}")
    };
    RenderingCancel => jobs::renderings::cancel, Operation {
        command: "render-cancel",
        summary: "Cancel a rendering",
        description: "Its process ends at once, without a result. A rendering that is over stays as it is.",
        parameter: Some("The rendering's id, or `last`"),
        answer: Answer::Json("Rendering"),
        ..Operation::delete("/v1/renderings/{id}")
    };
    Calibrate => calibration::handlers::calibrate, Operation {
        command: "calibrate",
        summary: "Measure the gains of the motors",
        description: "The daemon queues a play of bursts of several lengths, open loop, for about a minute. The event \
                      `calibrated` reports whether it has stored the gains. No other play is taken meanwhile. With \
                      `laser` it is a play like any other, and `PUT /v1/calibration` stores the gains.",
        body: Body::OptionalJson("CalibrateRequest"),
        statuses: ACCEPTED,
        answer: Answer::Json("PlayAccepted"),
        ..Operation::post("/v1/calibrate")
    };
    Calibration => calibration::handlers::show, Operation {
        summary: "Show the stored calibration",
        description: "The daemon uses a calibration only for the device it was measured on.",
        answer: Answer::Json("CalibrationReport"),
        ..Operation::get("/v1/calibration")
    };
    StoreCalibration => calibration::handlers::store, Operation {
        command: "store-calibration",
        summary: "Store gains that were measured elsewhere, as with a laser",
        description: "The body is a calibration file of the connected device, of at most 256 KiB. The daemon replaces the \
                      motors in it, keeps the others, and uses the gains at once. No play may be queued.",
        body: Body::Calibration,
        answer: Answer::Json("CalibrationReport"),
        ..Operation::put("/v1/calibration")
    };
    SessionStart => sessions::handlers::start, Operation {
        command: "session-start",
        access: Access { session: SessionRule::Starts, ..Access::CHANGES },
        summary: "Start a session",
        description: "One session runs at a time, and every play meanwhile belongs to it. A client that sends \
                      `Authorization: Bearer TOKEN` with the answer's token is the owner. During an exclusive session every \
                      other client may only read, stop and disarm, and order emergency stops. If the owner sends nothing for \
                      `session_silence_s` of the configuration, others may act; the session goes on.",
        body: Body::Json("SessionRequest"),
        statuses: &[(201, "Started")],
        answer: Answer::Json("SessionStarted"),
        ..Operation::post("/v1/sessions")
    };
    Sessions => sessions::handlers::list, Operation {
        summary: "List the recorded sessions",
        description: "The daemon reads the session record, the oldest first: at most the newest 10000. Lines that it cannot \
                      read are counted and named.",
        answer: Answer::Json("SessionList"),
        ..Operation::get("/v1/sessions")
    };
    SessionShow => sessions::handlers::show, Operation {
        summary: "Show a session",
        description: "The running one from memory, and ended ones from the session record.",
        parameter: Some("The session's id, or `running`"),
        answer: Answer::Json("Session"),
        ..Operation::get("/v1/sessions/{id}")
    };
    SessionPlays => sessions::handlers::plays, Operation {
        summary: "Show the recorded plays of a session",
        description: "The daemon reads the session record. An answer has at most 1000 rows; `from` leaves out the first.",
        parameter: Some("The session's id"),
        queries: &[Query::Number {
            name: "from",
            most: 1e9,
            about: "How many plays to leave out; without it none",
        }],
        answer: Answer::Json("SessionPlays"),
        ..Operation::get("/v1/sessions/{id}/plays")
    };
    SessionEnd => sessions::handlers::end, Operation {
        command: "session-end",
        summary: "End a session",
        description: "The daemon refuses it while a play waits or runs.",
        parameter: Some("The session's id, or `running`"),
        answer: Answer::Json("Session"),
        ..Operation::post("/v1/sessions/{id}/end")
    };
    TokenCreate => tokens::handlers::create, Operation {
        command: "token-create",
        access: Access { local: true, ..Access::CHANGES },
        summary: "Create an access token for clients that come over the network",
        description: "Only clients of the Unix socket may do this, during an exclusive session only its owner. The daemon keeps \
                      a hash and shows the token once. There are at most 100 tokens. A network client sends it as `Authorization: Bearer TOKEN`, and the token of a session \
                      in the header `Meissner-Session`.",
        body: Body::Json("TokenRequest"),
        statuses: &[(201, "Created")],
        answer: Answer::Json("TokenCreated"),
        ..Operation::post("/v1/tokens")
    };
    Tokens => tokens::handlers::list, Operation {
        access: Access { local: true, ..Access::MAKES_SAFE },
        summary: "List the access tokens",
        description: "Without their secrets. Only clients of the Unix socket may do this.",
        answer: Answer::Json("TokenList"),
        ..Operation::get("/v1/tokens")
    };
    TokenRevoke => tokens::handlers::revoke, Operation {
        command: "token-revoke",
        access: Access { local: true, ..Access::CHANGES },
        summary: "Revoke an access token",
        description: "At once it is not valid any more: what its clients have open or waiting ends, also their plays. Only clients \
                      of the Unix socket may do this, during an exclusive session only its owner.",
        parameter: Some("The token's id"),
        answer: Answer::Json("TokenInfo"),
        ..Operation::delete("/v1/tokens/{id}")
    };
    Metrics => status::metrics::metrics, Operation {
        summary: "Show counters and gauges for Prometheus",
        description: "In the text format 0.0.4 of Prometheus.",
        answer: Answer::Text(
            "text/plain; version=0.0.4",
            "meissner_plays_total{end=\"done\"} 1\nmeissner_state{state=\"armed\"} 1\n",
        ),
        ..Operation::get("/v1/metrics")
    };
    OpenApi => status::handlers::openapi, Operation {
        summary: "Show this document",
        description: "OpenAPI 3.1, made from the types that the daemon uses.",
        answer: Answer::OpenApi,
        ..Operation::get("/v1/openapi.json")
    };
}

impl Route {
    /// The route that takes this method and path. It uses no heap.
    pub fn find(method: &str, path: &str) -> Option<Self> {
        let method = match method {
            "GET" | "HEAD" => Method::Get,
            "POST" => Method::Post,
            "PUT" => Method::Put,
            "DELETE" => Method::Delete,
            _ => return None,
        };
        Self::ALL.into_iter().find(|route| route.method() == method && takes(route.path(), path))
    }
}

/// Whether a path fits a route's, whose parts in braces stand for any text.
fn takes(route: &str, path: &str) -> bool {
    let mut parts = path.split('/');
    let fits = |wanted: &str| {
        parts
            .next()
            .is_some_and(|part| if wanted.starts_with('{') { !part.is_empty() } else { part == wanted })
    };
    route.split('/').all(fits) && parts.next().is_none()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_finds_its_route_and_no_other() {
        for route in Route::ALL {
            let method = match route.method() {
                Method::Get => "GET",
                Method::Post => "POST",
                Method::Put => "PUT",
                Method::Delete => "DELETE",
            };
            let path = route.path().replace("{name}", "x").replace("{id}", "7").replace("{key}", "00");
            assert_eq!(Route::find(method, &path), Some(route), "{method} {path}");
            assert_ne!(Route::find("PATCH", &path), Some(route));
            assert_ne!(Route::find(method, &(path + "/more")), Some(route));
        }
        assert_eq!(Route::find("HEAD", "/v1/live/00"), Some(Route::LiveConnection));
        for path in ["", "/", "/v1", "/v1/", "/v1/plays/", "/v1//live/0", "/v1/%6cive/0"] {
            assert_eq!(Route::find("GET", path), None, "{path}");
        }
    }
}
