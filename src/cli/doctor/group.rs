//! Checks whether the user who runs the doctor may use the service's socket.

use crate::doctor::service::{SERVICE, SOCKET, Units};
use meissner_api::Finding;
use meissner_client::SERVICE_SOCKET;
use meissner_client::access::{CurrentUser, Membership, UserGroup, join_command};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

const GROUP: &str = "haptics";

/// Whether this user may use the service's socket.
pub(super) fn finding(root: &Path, units: &Units, me: &CurrentUser) -> Option<Finding> {
    let socket = fs::metadata(root.join(SERVICE_SOCKET.trim_start_matches('/'))).ok();
    if !units.is_installed() && socket.is_none() {
        return None;
    }
    let owner = socket.and_then(|socket| UserGroup::of(socket.gid()));
    Some(judged(me, UserGroup::named(GROUP).as_ref(), owner.as_ref()))
}

/// Judges by the socket's actual group, because a site may have changed it.
fn judged(me: &CurrentUser, haptics: Option<&UserGroup>, owner: Option<&UserGroup>) -> Finding {
    if owner.is_some_and(|owner| owner.gid == 0) {
        let found = format!("the socket belongs to the group `root`, not to `{GROUP}`");
        return Finding::warn("group", found, format!("`sudo systemctl restart {SOCKET} {SERVICE}`"));
    }
    let Some(members) = owner.or(haptics) else {
        let found = format!("there is no group `{GROUP}`, so no user may use the service's socket");
        let advice = format!("`sudo groupadd --system {GROUP} && sudo systemctl restart {SOCKET}`");
        return Finding::warn("group", found, advice);
    };
    let (CurrentUser { name, .. }, UserGroup { group, .. }) = (me, members);
    match me.membership(members) {
        _ if me.uid == 0 => Finding::ok("group", format!("root needs no group; other users need `{group}`")),
        Membership::Member => Finding::ok("group", format!("you ({name}) are in `{group}`")),
        Membership::MemberAfterLogin => {
            let found = format!("you ({name}) are in `{group}`, but not yet in this session");
            Finding::warn("group", found, "log in again")
        }
        Membership::NotMember => {
            let found = format!("you ({name}) are not in `{group}`: the service refuses you");
            Finding::warn("group", found, join_command(me, members))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doctor::fake;

    #[test]
    fn where_nothing_is_installed_no_group_is_needed() {
        let dir = tempfile::tempdir().unwrap();
        let me = CurrentUser { name: "anna".into(), uid: 1000, login_gid: 1000, gids: vec![1000] };
        assert!(finding(dir.path(), &Units::new(dir.path(), None), &me).is_none());
    }

    #[test]
    fn a_user_outside_the_group_learns_how_to_join() {
        let me = |uid, gids: &[u32]| CurrentUser {
            name: "anna".into(),
            uid,
            login_gid: 1000,
            gids: gids.to_vec(),
        };
        let members = |group: &str, gid, names: &[&str]| UserGroup {
            group: group.to_owned(),
            gid,
            names: names.iter().map(|&name| name.to_owned()).collect(),
        };
        let (empty, hers) = (members("haptics", 991, &[]), members("haptics", 991, &["anna"]));
        let line = |me: &CurrentUser, group, owner| fake::line(&judged(me, group, owner));
        let anna = me(1000, &[1000]);
        assert_eq!(
            line(&anna, Some(&empty), None),
            "Warn group: you (anna) are not in `haptics`: the service refuses you -> `sudo usermod -aG haptics \
             anna`, then log in again"
        );
        assert!(line(&anna, Some(&hers), Some(&hers)).ends_with("not yet in this session -> log in again"));
        assert_eq!(
            line(&me(1000, &[991]), Some(&hers), Some(&hers)),
            "Ok group: you (anna) are in `haptics` -> "
        );
        assert!(line(&me(0, &[0]), Some(&empty), None).starts_with("Ok group: root needs no group"));
        assert!(line(&anna, None, None).contains("-> `sudo groupadd --system haptics && "));
        let (site, root) = (members("touch", 1200, &[]), members("root", 0, &[]));
        let another = line(&anna, Some(&hers), Some(&site));
        assert!(
            another.contains("not in `touch`") && another.contains("usermod -aG touch anna"),
            "{another}"
        );
        let line = line(&anna, Some(&hers), Some(&root));
        assert!(line.starts_with("Warn group: the socket belongs to the group `root`"), "{line}");
        assert!(line.contains("-> `sudo systemctl restart meissner.socket"), "{line}");
    }
}
