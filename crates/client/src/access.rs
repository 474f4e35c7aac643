//! Who may use a socket: its group, who is in it, and the command that puts somebody in.
//!
//! Users and groups are looked up by the system's own means, so that a site's directory counts like `/etc/group`. It
//! changes nothing, and does not look at access lists: what it cannot explain it says nothing about.
//!
//! Invariant: who is named a group by [`join`] is not in it, neither now nor after logging in again.

use nix::unistd::{Gid, Group, Uid, User, getegid, geteuid, getgroups};
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

/// Who runs this process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Me {
    /// By name.
    pub name: String,
    /// By number.
    pub uid: u32,
    /// The group a login begins with.
    pub login_gid: u32,
    /// What this process is in.
    pub gids: Vec<u32>,
}

/// A group of users.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Members {
    /// Its name.
    pub group: String,
    /// Its number.
    pub gid: u32,
    /// Who is listed in it.
    pub names: Vec<String>,
}

/// How one stands to a group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Standing {
    /// In it.
    In,
    /// In it, but this session began before that.
    AfterLogin,
    /// Not in it.
    Out,
}

impl Me {
    /// Whoever it is, if the system knows a name.
    #[must_use]
    pub fn look_up() -> Option<Self> {
        let uid = geteuid();
        let user = User::from_uid(uid).ok()??;
        let mut gids: Vec<u32> = getgroups().unwrap_or_default().into_iter().map(Gid::as_raw).collect();
        gids.push(getegid().as_raw());
        Some(Self { name: user.name, uid: uid.as_raw(), login_gid: user.gid.as_raw(), gids })
    }

    /// How they stand to this group.
    #[must_use]
    pub fn stands(&self, group: &Members) -> Standing {
        if self.gids.contains(&group.gid) {
            Standing::In
        } else if self.login_gid == group.gid || group.names.contains(&self.name) {
            Standing::AfterLogin
        } else {
            Standing::Out
        }
    }
}

impl Members {
    /// Of the group of this number.
    #[must_use]
    pub fn of(gid: u32) -> Option<Self> {
        Some(Self::from(Group::from_gid(Gid::from_raw(gid)).ok()??))
    }

    /// Of the group of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Some(Self::from(Group::from_name(name).ok()??))
    }
}

impl From<Group> for Members {
    fn from(group: Group) -> Self {
        Self { group: group.name, gid: group.gid.as_raw(), names: group.mem }
    }
}

/// What puts somebody in a group.
#[must_use]
pub fn join(me: &Me, group: &Members) -> String {
    format!("`sudo usermod -aG {} {}`, then log in again", group.group, me.name)
}

/// Why this process may not use a socket that is there, and what to do; `None` if that cannot be told.
pub(super) fn denied(socket: &Path) -> Option<(String, String)> {
    let there = fs::metadata(socket).ok()?;
    let owner = User::from_uid(Uid::from_raw(there.uid())).ok().flatten();
    let owner = owner.map_or_else(|| format!("uid {}", there.uid()), |user| user.name);
    why(&Me::look_up()?, &Members::of(there.gid())?, (there.uid(), &owner), there.mode(), socket)
}

fn why(
    me: &Me,
    group: &Members,
    (uid, owner): (u32, &str),
    mode: u32,
    socket: &Path,
) -> Option<(String, String)> {
    const ELSE: &str = "or choose another with --socket";
    let Me { name, .. } = me;
    if uid == me.uid {
        let found = format!("its mode {:03o} lets nobody in, not even you ({name})", mode & 0o777);
        return Some((found, format!("`chmod 660 {}`, {ELSE}", socket.display())));
    }
    // Nobody is told to join root's own group.
    if mode & 0o020 == 0 || group.gid == 0 {
        let found = format!("only {owner} may use it, and you are {name}");
        return Some((found, format!("run this with `sudo -u {owner}`, {ELSE}")));
    }
    let group_name = &group.group;
    match me.stands(group) {
        Standing::In => None,
        Standing::AfterLogin => {
            let found = format!("you ({name}) are in its group `{group_name}`, but not yet in this session");
            Some((found, "log in again".to_owned()))
        }
        Standing::Out => Some((format!("you ({name}) are not in its group `{group_name}`"), join(me, group))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn anna(gids: &[u32]) -> Me {
        Me { name: "anna".into(), uid: 1000, login_gid: 1000, gids: gids.to_vec() }
    }

    fn haptics(names: &[&str]) -> Members {
        let names = names.iter().map(|&name| name.to_owned()).collect();
        Members { group: "haptics".into(), gid: 991, names }
    }

    fn line(me: &Me, group: &Members, owner: (u32, &str), mode: u32) -> String {
        let why = why(me, group, owner, mode, Path::new("/run/m.sock"));
        why.map_or_else(String::new, |(found, advice)| format!("{found}: {advice}"))
    }

    #[test]
    fn who_is_refused_is_told_the_command_that_helps() {
        let daemon = (990, "meissner");
        let line = |me: &Me, group: &Members, mode| line(me, group, daemon, mode);
        assert_eq!(
            line(&anna(&[1000]), &haptics(&[]), 0o140_660),
            "you (anna) are not in its group `haptics`: `sudo usermod -aG haptics anna`, then log in again"
        );
        assert_eq!(
            line(&anna(&[1000]), &haptics(&["bert", "anna"]), 0o140_660),
            "you (anna) are in its group `haptics`, but not yet in this session: log in again"
        );
        // It is not the group then.
        assert_eq!(line(&anna(&[1000, 991]), &haptics(&["anna"]), 0o140_660), "");
        let only = "only meissner may use it, and you are anna: run this with `sudo -u meissner`, or choose \
                    another with --socket";
        assert_eq!(line(&anna(&[1000]), &haptics(&[]), 0o140_600), only);
        let roots = Members { group: "root".into(), gid: 0, names: Vec::new() };
        assert_eq!(line(&anna(&[1000]), &roots, 0o140_660), only, "nobody is told to join root's group");
    }

    #[test]
    fn whose_own_socket_is_closed_is_told_so() {
        let line = line(&anna(&[1000]), &haptics(&[]), (1000, "anna"), 0o140_000);
        assert!(
            line.starts_with("its mode 000 lets nobody in") && line.contains("`chmod 660 /run/m.sock`"),
            "{line}"
        );
    }

    #[test]
    fn a_group_one_logs_in_with_counts() {
        let me = Me { login_gid: 991, ..anna(&[1000]) };
        assert_eq!(me.stands(&haptics(&[])), Standing::AfterLogin);
        // Whoever runs the tests: the system knows how to tell.
        if let Some(me) = Me::look_up() {
            assert!(me.gids.contains(&getegid().as_raw()));
        }
        assert_eq!(Members::named("no-such-group"), None);
    }
}
