//! Checks the processors: whether they slow down when they are idle.

use meissner_api::Finding;
use std::fs;
use std::path::Path;

const CPUS: &str = "sys/devices/system/cpu";
const FAST: &str = "performance";

/// Whether processors slow down when they are idle, so that every wake-up begins slowly.
pub(super) fn governor(root: &Path) -> Finding {
    let Ok(cpus) = fs::read_dir(root.join(CPUS)) else {
        let found = format!("/{CPUS} cannot be read from here");
        return Finding::warn(
            "governor",
            found,
            "run `meissner doctor` on the machine itself, not in a container",
        );
    };
    let cpus = cpus.flatten();
    let is_cpu = |name: &str| {
        name.strip_prefix("cpu")
            .is_some_and(|number| !number.is_empty() && number.bytes().all(|c| c.is_ascii_digit()))
    };
    let governors = cpus.filter(|cpu| cpu.file_name().to_str().is_some_and(is_cpu));
    let governors =
        governors.filter_map(|cpu| fs::read_to_string(cpu.path().join("cpufreq/scaling_governor")).ok());
    let governors: Vec<String> = governors.map(|governor| governor.trim().to_owned()).collect();
    let slow: Vec<&String> = governors.iter().filter(|governor| *governor != FAST).collect();
    match slow.iter().min() {
        None if governors.is_empty() => Finding::ok("governor", "this machine does not scale its frequency"),
        None => Finding::ok("governor", FAST),
        Some(name) => {
            let found =
                format!("`{name}` slows {} of {} processors down when idle", slow.len(), governors.len());
            let advice = format!(
                "`echo {FAST} | sudo tee /{CPUS}/cpu*/cpufreq/scaling_governor` (until the next boot)"
            );
            Finding::warn("governor", found, advice)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

    #[test]
    fn processors_that_slow_down_are_reported() {
        let dir = tempfile::tempdir().unwrap();
        let governor = || fake::line(&governor(dir.path()));
        assert!(
            governor().starts_with("Warn governor: /sys/devices/system/cpu cannot be read from here -> ")
        );
        fake::write(dir.path(), &format!("{CPUS}/cpu0/online"), "1\n");
        assert_eq!(governor(), "Ok governor: this machine does not scale its frequency -> ");
        let set = |cpu, text| {
            fake::write(dir.path(), &format!("{CPUS}/{cpu}/cpufreq/scaling_governor"), text);
        };
        set("cpu0", "performance\n");
        set("cpu11", "performance\n");
        set("cpufreq", "powersave\n");
        assert_eq!(governor(), "Ok governor: performance -> ");
        set("cpu11", "schedutil\n");
        assert_eq!(
            governor(),
            "Warn governor: `schedutil` slows 1 of 2 processors down when idle -> `echo performance | sudo tee \
             /sys/devices/system/cpu/cpu*/cpufreq/scaling_governor` (until the next boot)"
        );
    }
}
