//! The response of the afferents that the daemon predicts for a play, in receipts.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The response of the afferents predicted for a play, from its bursts as telemetry measured them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct PredictedResponse {
    /// The part of the play that the prediction covers, from the onset on, s.
    #[schema(minimum = 0.0, maximum = 60.0)]
    pub seconds: f64,
    /// The target the pattern was made for; null if it was made for none.
    #[schema(required)]
    pub target: Option<String>,
    /// Seed of the population of afferents and of their noise.
    pub population_seed: u64,
    /// Rates of the RA afferents predicted by the first model, `membrane`, for the pattern as designed, impulses/s.
    pub designed_hz: Rates,
    /// The same for the bursts as measured.
    pub played_hz: Rates,
    /// Rates predicted by the second model, `afferents`, for each class: SA1, RA, PC. Empty from an older daemon.
    #[serde(default)]
    #[schema(required, max_items = 3)]
    pub afferents: Vec<ClassResponse>,
    /// Number of bursts without a measurement; the prediction takes them as not played.
    pub unmeasured: u64,
}

/// The predicted response of a class of afferents.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct ClassResponse {
    /// The class.
    pub class: AfferentClass,
    /// Rates predicted for the pattern as designed, impulses/s.
    pub designed_hz: Rates,
    /// Rates predicted for the bursts as measured, impulses/s.
    pub played_hz: Rates,
}

/// A class of afferents.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub enum AfferentClass {
    /// Slowly adapting, type 1: Merkel cells.
    #[serde(rename = "SA1")]
    Sa1,
    /// Rapidly adapting: Meissner corpuscles.
    #[serde(rename = "RA")]
    Ra,
    /// Pacinian corpuscles.
    #[serde(rename = "PC")]
    Pc,
}

impl AfferentClass {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Sa1 => "SA1",
            Self::Ra => "RA",
            Self::Pc => "PC",
        }
    }
}

/// What is known of a play's predicted response: nothing yet, the response, or why there is none.
///
/// JSON has each key twice: `predicted_response` and `predicted_response_unknown`, and their deprecated names `felt` and
/// `felt_unknown`. Either name is read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "PredictionKeys", into = "PredictionKeys")]
pub struct Prediction {
    /// The response, once it is computed.
    pub response: Option<PredictedResponse>,
    /// Why it cannot be predicted.
    pub unknown: Option<String>,
}

impl Prediction {
    /// Whether the daemon has computed it, or has given up.
    #[must_use]
    pub const fn is_settled(&self) -> bool {
        self.response.is_some() || self.unknown.is_some()
    }
}

/// The predicted afferent response to a play, under its present and its deprecated keys.
#[derive(Serialize, Deserialize, ToSchema)]
#[schema(as = Prediction)]
pub(crate) struct PredictionKeys {
    /// The predicted response; null until it is computed.
    #[serde(default)]
    #[schema(required)]
    predicted_response: Option<PredictedResponse>,
    /// Why the response cannot be predicted; null if it can, or was not tried yet.
    #[serde(default)]
    #[schema(required)]
    predicted_response_unknown: Option<String>,
    /// Deprecated: read `predicted_response`.
    #[serde(default)]
    #[schema(required, deprecated)]
    felt: Option<PredictedResponse>,
    /// Deprecated: read `predicted_response_unknown`.
    #[serde(default)]
    #[schema(required, deprecated)]
    felt_unknown: Option<String>,
}

impl From<PredictionKeys> for Prediction {
    fn from(keys: PredictionKeys) -> Self {
        Self {
            response: keys.predicted_response.or(keys.felt),
            unknown: keys.predicted_response_unknown.or(keys.felt_unknown),
        }
    }
}

impl From<Prediction> for PredictionKeys {
    fn from(Prediction { response, unknown }: Prediction) -> Self {
        Self {
            predicted_response: response.clone(),
            predicted_response_unknown: unknown.clone(),
            felt: response,
            felt_unknown: unknown,
        }
    }
}

/// Mean impulse rates. Null: the pattern has no target, no frame of the target's motion was observed, or no afferent of the
/// class is on the target.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Rates {
    /// Mean rate of all afferents, impulses/s.
    #[schema(minimum = 0.0)]
    pub all: f64,
    /// Mean rate of the on-target afferents, impulses/s.
    #[schema(required, minimum = 0.0)]
    pub on: Option<f64>,
    /// Mean rate of the off-target afferents, impulses/s.
    #[schema(required, minimum = 0.0)]
    pub off: Option<f64>,
    /// Contrast: on-target minus off-target rate, impulses/s.
    #[schema(required)]
    pub contrast: Option<f64>,
}
