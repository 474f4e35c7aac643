//! `GET /v1/doctor`: the same findings as the command's, each verdict, many clients at once.

use crate::harness::{Daemon, PATIENT, document};
use meissner_api::{DoctorReport, Finding, Level, Status};
use serde_json::json;

fn report(daemon: &Daemon) -> DoctorReport {
    daemon.client().get("/v1/doctor").unwrap()
}

fn verdict(report: &DoctorReport, what: &str) -> Option<Level> {
    report.findings.iter().find(|finding| finding.what == what).map(|finding| finding.level)
}

/// The finding without the parts that change with the clock's estimate.
fn stable(finding: &Finding) -> Finding {
    if finding.what == "clock" { Finding::ok("clock", "") } else { finding.clone() }
}

#[test]
fn the_command_and_the_route_give_the_same_findings() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:0\"\n"));
    let route: Vec<Finding> = report(&daemon).findings.iter().map(stable).collect();
    let command = document(daemon.meissner().args(["doctor", "--json", "--seconds", "0.1"]));
    let command: Vec<Finding> = serde_json::from_value(command["findings"].clone()).unwrap();
    let command: Vec<Finding> = command.iter().map(stable).collect();
    // Findings that only the command can make: its user's rights and groups, and the timers.
    let own = ["SCHED_FIFO", "mlockall", "timers", "group"];
    let shared: Vec<&Finding> =
        command.iter().filter(|finding| !own.contains(&finding.what.as_str())).collect();
    assert_eq!(shared, route.iter().collect::<Vec<_>>());
    assert!(route.len() > 5 && command.len() > route.len(), "{command:#?}");
}

#[test]
fn each_verdict_comes_with_its_remedy() {
    let daemon = Daemon::start();
    let found = report(&daemon);
    assert!(found.ok && verdict(&found, "network") == Some(Level::Ok), "{found:#?}");
    assert_eq!([verdict(&found, "device"), verdict(&found, "state")], [Some(Level::Warn); 2]);
    assert!(found.findings.iter().all(|of| (of.level == Level::Ok) == of.advice.is_empty()), "{found:#?}");
    daemon.armed();
    assert_eq!(verdict(&report(&daemon), "state"), Some(Level::Ok));
    let _: Status = daemon.client().post("/v1/estop", &json!({})).unwrap();
    let found = report(&daemon);
    assert!(!found.ok && verdict(&found, "state") == Some(Level::Fail), "{found:#?}");
    let absent = Daemon::without_device("serial:/nonexistent/tty");
    absent.wait_for_log("not there");
    let found = report(&absent);
    let fail = found.findings.iter().find(|finding| finding.level == Level::Fail).unwrap();
    assert!(!found.ok && fail.found.contains("/nonexistent/tty: not there"), "{found:#?}");
}
