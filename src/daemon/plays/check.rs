//! Checks an order before it is played: how far it would let pins drift on a device without telemetry.

use crate::daemon::core::engine::Engine;
use crate::daemon::core::runtime::CHECKS;
use crate::daemon::plays::begin;
use crate::daemon::plays::begin::Compiled;
use crate::record::Peer;
use crate::store::Stored;
use meissner_api::{Code, Order, PlanCheck, PlanStop, Problem};
use meissner_stream::{Drift, Source, forecast_drift};
use std::future::Future;

/// Tells how far a play would let pins drift on a device without telemetry.
pub(in crate::daemon) async fn check_order<P, F: Future<Output = Result<(Stored, P), Problem>>>(
    engine: &Engine,
    order: &Order,
    client: Peer,
    find: impl Fn(String, Option<String>) -> F,
) -> Result<PlanCheck, Problem> {
    let basis = begin::compiles_for(engine, order.terms.boot, order.terms.open_loop)?;
    let (gains, calibrated) = {
        let state = engine.lock();
        (state.gains(), state.calibration.in_use().is_some())
    };
    let settings = basis.0;
    let compiled = Compiled::of_order(order, basis, client, &CHECKS, find).await?;
    let Source::Compiled(strokes) = compiled.play.strokes else {
        return Err(Problem::new(Code::BadRequest, "internal error: an order is not live"));
    };
    let rate = settings.array.rate();
    let end = strokes
        .end()
        .ok_or_else(|| Problem::new(Code::BadRequest, "the play has no end: say how many `seconds`"))?;
    let drift = CHECKS.computing(move || forecast_drift(*strokes, &settings, &gains)).await?;
    let Drift { um, motor, stopped_at, followed_until } =
        drift.map_err(|error| Problem::new(Code::BadRequest, error.to_string()))?;
    let planned = compiled.new.items;
    let stopped_at = stopped_at.map(|at| {
        let item = planned.partition_point(|item| item.span.0 <= at).saturating_sub(1);
        let pattern = planned.get(item).map(|item| item.pattern.to_string()).unwrap_or_default();
        PlanStop { item, pattern, after_ms: rate.ticks_to_ms(at) }
    });
    Ok(PlanCheck {
        items: order.items.len(),
        ordered_ms: rate.ticks_to_ms(end),
        drift_um: um,
        drift_limit_um: settings.drift_limit_um,
        motor,
        lower_stop: settings.lower_stop.is_some(),
        calibrated,
        stopped_at,
        followed_ms: followed_until.map(|at| rate.ticks_to_ms(at)),
    })
}
