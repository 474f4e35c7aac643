//! Explains why a user may not use the daemon's socket, and which command helps.
//!
//! The client calls it when the system denies a connection. It looks users and groups up with the
//! system's own functions, so that a site's directory service counts like `/etc/group`. It does not read access control lists, and
//! gives no explanation where they may decide.
//!
//! Invariant: joining the group is offered only to users who are not members of the group, now or after the next login.

use nix::unistd::{Gid, Group, Uid, User, getegid, geteuid, getgroups};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// The user who runs this process.
struct CurrentUser {
    /// Name.
    name: String,
    /// User id.
    uid: u32,
    /// Id of the primary group, as a login sets it.
    login_gid: u32,
    /// Ids of the groups this process belongs to.
    gids: Vec<u32>,
}

/// A group of users.
struct UserGroup {
    /// Name.
    group: String,
    /// Group id.
    gid: u32,
    /// Names of the users listed in it.
    names: Vec<String>,
}

impl CurrentUser {
    /// The user who runs this process; `None` if the system knows no name for the id.
    fn look_up() -> Option<Self> {
        let uid = geteuid();
        let user = User::from_uid(uid).ok()??;
        let mut gids: Vec<u32> = getgroups().unwrap_or_default().into_iter().map(Gid::as_raw).collect();
        gids.push(getegid().as_raw());
        Some(Self { name: user.name, uid: uid.as_raw(), login_gid: user.gid.as_raw(), gids })
    }
}

/// Why this process may not use an existing socket, and what to do; `None` if file modes and groups do not explain it.
pub(super) fn denied(socket: &Path) -> Option<(String, String)> {
    let there = fs::metadata(socket).ok()?;
    let owner = User::from_uid(Uid::from_raw(there.uid())).ok().flatten();
    let owner = owner.map_or_else(|| format!("uid {}", there.uid()), |user| user.name);
    let group = Group::from_gid(Gid::from_raw(there.gid())).ok()??;
    let group = UserGroup { group: group.name, gid: there.gid(), names: group.mem };
    why(&CurrentUser::look_up()?, &group, (there.uid(), &owner), there.mode(), socket)
}

fn why(
    me: &CurrentUser,
    group: &UserGroup,
    (uid, owner): (u32, &str),
    mode: u32,
    socket: &Path,
) -> Option<(String, String)> {
    const OTHERWISE: &str = "or choose another with --socket";
    let CurrentUser { name, .. } = me;
    if uid == me.uid {
        let found = format!("its mode {:03o} lets nobody in, not even you ({name})", mode & 0o777);
        return Some((found, format!("`chmod 660 {}`, {OTHERWISE}", socket.display())));
    }
    // Nobody should join root's own group.
    if mode & 0o020 == 0 || group.gid == 0 {
        let found = format!("only {owner} may use it, and you are {name}");
        return Some((found, format!("run this with `sudo -u {owner}`, {OTHERWISE}")));
    }
    let group_name = &group.group;
    if me.gids.contains(&group.gid) {
        return None;
    }
    if me.login_gid == group.gid || group.names.contains(name) {
        let found = format!("you ({name}) are in its group `{group_name}`, but not yet in this session");
        return Some((found, "log in again".to_owned()));
    }
    let advice = format!("`sudo usermod -aG {group_name} {name}`, then log in again");
    Some((format!("you ({name}) are not in its group `{group_name}`"), advice))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anna(gids: &[u32]) -> CurrentUser {
        CurrentUser { name: "anna".into(), uid: 1000, login_gid: 1000, gids: gids.to_vec() }
    }

    fn haptics(names: &[&str]) -> UserGroup {
        let names = names.iter().map(|&name| name.to_owned()).collect();
        UserGroup { group: "haptics".into(), gid: 991, names }
    }

    fn line(me: &CurrentUser, group: &UserGroup, owner: (u32, &str), mode: u32) -> String {
        let why = why(me, group, owner, mode, Path::new("/run/m.sock"));
        why.map_or_else(String::new, |(found, advice)| format!("{found}: {advice}"))
    }

    #[test]
    fn a_denied_user_gets_the_command_that_helps() {
        let daemon = (990, "meissner");
        let line = |me: &CurrentUser, group: &UserGroup, mode| line(me, group, daemon, mode);
        assert_eq!(
            line(&anna(&[1000]), &haptics(&[]), 0o140_660),
            "you (anna) are not in its group `haptics`: `sudo usermod -aG haptics anna`, then log in again"
        );
        assert_eq!(
            line(&anna(&[1000]), &haptics(&["bert", "anna"]), 0o140_660),
            "you (anna) are in its group `haptics`, but not yet in this session: log in again"
        );
        // The group does not explain the denial.
        assert_eq!(line(&anna(&[1000, 991]), &haptics(&["anna"]), 0o140_660), "");
        let only = "only meissner may use it, and you are anna: run this with `sudo -u meissner`, or choose \
                    another with --socket";
        assert_eq!(line(&anna(&[1000]), &haptics(&[]), 0o140_600), only);
        let roots = UserGroup { group: "root".into(), gid: 0, names: Vec::new() };
        assert_eq!(line(&anna(&[1000]), &roots, 0o140_660), only, "joining root's group is no remedy");
    }

    #[test]
    fn an_owner_without_write_permission_gets_a_chmod() {
        let line = line(&anna(&[1000]), &haptics(&[]), (1000, "anna"), 0o140_000);
        assert!(
            line.starts_with("its mode 000 lets nobody in") && line.contains("`chmod 660 /run/m.sock`"),
            "{line}"
        );
    }

    #[test]
    fn the_primary_group_counts() {
        let me = CurrentUser { login_gid: 991, ..anna(&[1000]) };
        let line = line(&me, &haptics(&[]), (990, "meissner"), 0o140_660);
        assert!(line.ends_with("but not yet in this session: log in again"), "{line}");
        // The user who runs the tests.
        if let Some(me) = CurrentUser::look_up() {
            assert!(me.gids.contains(&getegid().as_raw()));
        }
    }
}
