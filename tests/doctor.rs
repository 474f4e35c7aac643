//! `GET /v1/doctor`: the same findings as the command's.

use crate::harness::{Daemon, PATIENT, document};
use meissner_api::{DoctorReport, Finding};

/// The finding without the parts that change with the clock's estimate.
fn stable(finding: &Finding) -> Finding {
    if finding.what == "clock" { Finding::ok("clock", "") } else { finding.clone() }
}

#[test]
fn the_command_and_the_route_give_the_same_findings() {
    let daemon = Daemon::with("mock", &format!("{PATIENT}listen = \"127.0.0.1:0\"\n"));
    crate::boards::a_daemon_s_device_is_not_tested(&daemon);
    let report: DoctorReport = daemon.client().get("/v1/doctor").unwrap();
    let route: Vec<Finding> = report.findings.iter().map(stable).collect();
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
