//! The access tokens: creates, revokes and finds them, and keeps their hashes in a file.
//!
//! A token holds 256 random bits, so its SHA-256 needs no salt and cannot be guessed. The store compares a token with all valid
//! ones in constant time. The file is replaced atomically, and only the daemon's user can read it.
//!
//! Several daemons may share one file. To change it, a daemon locks the file beside it (`.lock`), reads the file, changes the
//! tokens, and writes it again; [`TokenStore::refresh`] reads the changes of others.
//!
//! Invariants: a file that cannot be read admits no token, and is not overwritten; a token that was revoked here is never valid
//! again, even if the file still has it.

use crate::file::{self, read_regular};
use crate::session_record::{TokenId, utc_now};
use crate::store::hexadecimal;
use arc_swap::ArcSwap;
use meissner_api::{Code, MAX_TOKENS, Problem, Role, TOKEN_PREFIX, TokenCreated, TokenInfo};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use rustix::rand::{GetRandomFlags, getrandom};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::{self, File, Metadata, OpenOptions};
use std::io;
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant, SystemTime};
use subtle::{Choice, ConditionallySelectable, ConstantTimeEq};
use tracing::{info, warn};

/// Characters of a token.
const LENGTH: usize = TOKEN_PREFIX.len() + 64;
/// The most bytes of the file.
const MAX_FILE: u64 = 1 << 20;
/// How long to wait for another daemon that changes the file: it holds the lock for milliseconds.
const LOCKED: Duration = Duration::from_secs(2);
/// A file that was changed less than this before it was read may change again with the same time, because file times have steps of
/// up to 10 ms.
const SETTLED: Duration = Duration::from_millis(100);

#[derive(Clone, Debug)]
struct Token {
    id: TokenId,
    sha256: [u8; 32],
    info: TokenInfo,
}

/// The file.
#[derive(Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: u32,
    #[serde(default, rename = "token")]
    tokens: Vec<Row>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    id: String,
    role: Role,
    name: String,
    created: String,
    sha256: String,
}

/// See the module.
#[derive(Debug)]
pub(in crate::daemon) struct TokenStore {
    /// Where tokens are kept; without it they are lost when the daemon ends.
    file: Option<PathBuf>,
    tokens: ArcSwap<Vec<Token>>,
    /// Held while tokens change.
    changing: Mutex<FileState>,
}

/// The state of the file as last read.
#[derive(Debug, Default)]
struct FileState {
    /// Why the file is not used.
    problem: Option<String>,
    /// The file that was read last; none if it must be read again.
    stamp: Option<Stamp>,
    /// Tokens that were revoked here and may still be in the file, because it could not be written.
    revoked: Vec<TokenId>,
}

/// Identifies a version of a file: it differs for another file, and after a change; all zero without a file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Stamp([i64; 8]);

impl Stamp {
    fn of(file: &Path) -> io::Result<Self> {
        match fs::metadata(file) {
            Ok(of) => Ok(Self([
                of.dev().cast_signed(),
                of.ino().cast_signed(),
                of.size().cast_signed(),
                of.mode().into(),
                of.mtime(),
                of.mtime_nsec(),
                of.ctime(),
                of.ctime_nsec(),
            ])),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(Self::default()),
            Err(error) => Err(error),
        }
    }
}

impl TokenStore {
    /// Reads the tokens of the file. If the file cannot be read, the log says so, and no token is valid.
    pub(in crate::daemon) fn open(file: Option<PathBuf>) -> Self {
        let store = Self { file, tokens: ArcSwap::default(), changing: Mutex::default() };
        store.refresh();
        store
    }

    pub(super) const fn has_file(&self) -> bool {
        self.file.is_some()
    }

    /// Reads the file if it has changed since it was read last. Returns whether other tokens are valid now. It waits for the disk.
    pub(super) fn refresh(&self) -> bool {
        self.refresh_known(&mut self.lock())
    }

    fn refresh_known(&self, known: &mut FileState) -> bool {
        let Some(file) = &self.file else { return false };
        let stamp = Stamp::of(file).ok();
        if stamp.is_some() && stamp == known.stamp {
            return false;
        }
        let (tokens, problem) = match read(file) {
            Ok(mut tokens) => {
                tokens.retain(|token| !known.revoked.contains(&token.id));
                (tokens, None)
            }
            Err(problem) => (Vec::new(), Some(problem)),
        };
        if problem != known.problem {
            match &problem {
                Some(problem) => warn!("{problem}: no access token is valid"),
                None => info!("{}: can be read again", file.display()),
            }
        }
        // Keep the stamp from before the reading, unless the file may have changed during it.
        known.stamp = stamp.filter(|_| is_settled(file));
        known.problem = problem;
        let valid = |of: &[Token]| {
            of.iter().map(|token| (token.id, token.sha256, token.info.role)).collect::<Vec<_>>()
        };
        let changed = valid(&tokens) != valid(&self.tokens.load());
        self.tokens.store(Arc::new(tokens));
        changed
    }

    /// Makes the heap allocations that the first look-up of a thread needs.
    pub(in crate::daemon) fn prepare_thread(&self) {
        drop(self.tokens.load());
    }

    /// The id and role of a token, if it is valid. Uses no heap on a prepared thread.
    pub(super) fn find(&self, token: &str) -> Option<(TokenId, Role)> {
        if !token.starts_with(TOKEN_PREFIX) || token.len() != LENGTH {
            return None;
        }
        let sha256: [u8; 32] = Sha256::digest(token).into();
        let tokens = self.tokens.load();
        let (mut found, mut at) = (Choice::from(0), 0u32);
        for (index, token) in (0u32..).zip(tokens.iter()) {
            let same = token.sha256.ct_eq(&sha256);
            at.conditional_assign(&index, same);
            found |= same;
        }
        let token = bool::from(found).then(|| tokens.get(at as usize)).flatten()?;
        Some((token.id, token.info.role))
    }

    /// The role of the valid token with this id.
    pub(in crate::daemon) fn role(&self, id: TokenId) -> Option<Role> {
        self.tokens.load().iter().find(|token| token.id == id).map(|token| token.info.role)
    }

    /// The valid tokens.
    pub(in crate::daemon) fn list(&self) -> Vec<TokenInfo> {
        self.tokens.load().iter().map(|token| token.info.clone()).collect()
    }

    /// Creates a token. It waits for the disk.
    pub(in crate::daemon) fn create(&self, role: Role, name: &str) -> Result<TokenCreated, Problem> {
        let mut bytes = [0; 36];
        let got = getrandom(&mut bytes, GetRandomFlags::empty());
        if got != Ok(bytes.len()) {
            return Err(Problem::new(
                Code::Store,
                "the system gives no random numbers for the token: try again",
            ));
        }
        let (id, secret) = bytes.split_at(4);
        let (id, token) = (
            TokenId(u32::from_be_bytes(id.try_into().unwrap_or_default())),
            format!("{TOKEN_PREFIX}{}", hexadecimal(secret)),
        );
        let info = TokenInfo { id: id.to_string(), role, name: name.to_owned(), created: utc_now() };
        let sha256 = Sha256::digest(&token).into();
        let mut known = self.lock();
        let _locked = self.lock_file()?;
        let mut tokens = self.current(&mut known)?;
        if tokens.len() >= MAX_TOKENS {
            let detail =
                format!("there are {MAX_TOKENS} tokens already: revoke one with `meissner token revoke ID`");
            return Err(Problem::new(Code::Exists, detail));
        }
        if tokens.iter().any(|token| token.id == id) {
            return Err(Problem::new(Code::Exists, "the token's id is taken by chance: create it again"));
        }
        tokens.push(Token { id, sha256, info: info.clone() });
        self.write(&mut known, &tokens)?;
        self.tokens.store(Arc::new(tokens));
        Ok(TokenCreated { info, token })
    }

    /// Revokes a token, at once; then waits for the disk.
    pub(in crate::daemon) fn revoke(&self, id: &str) -> Result<TokenInfo, Problem> {
        let mut known = self.lock();
        let before = self.tokens.load_full();
        // Another daemon may have created it.
        self.refresh_known(&mut known);
        let mut tokens = self.tokens.load().to_vec();
        let found = tokens.iter().chain(before.iter()).find(|token| token.info.id == id).cloned();
        let Some(Token { id: number, info: revoked, .. }) = found else {
            return Err(match &known.problem {
                Some(problem) => Problem::new(Code::Store, problem),
                None => {
                    Problem::new(Code::NotFound, format!("there is no token {id}: see `meissner token list`"))
                }
            });
        };
        // Revoke it in memory first: a full disk must not keep a token valid.
        known.revoked.push(number);
        tokens.retain(|token| token.id != number);
        self.tokens.store(Arc::new(tokens));
        let written = self.lock_file().and_then(|_locked| {
            let tokens = self.current(&mut known)?;
            self.write(&mut known, &tokens)
        });
        written.map_err(|problem| {
            let detail = format!("{}; token {id} is revoked until the daemon restarts", problem.detail);
            Problem::new(Code::Store, detail)
        })?;
        Ok(revoked)
    }

    /// Locks out other changes by this daemon.
    fn lock(&self) -> MutexGuard<'_, FileState> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Locks out changes by other daemons, until the returned file is closed.
    fn lock_file(&self) -> Result<Option<File>, Problem> {
        let Some(file) = &self.file else { return Ok(None) };
        let path = file.with_added_extension("lock");
        let bad = |error: io::Error| {
            Problem::new(Code::Store, format!("{}: cannot be locked: {error}", path.display()))
        };
        let open = || {
            fs::create_dir_all(file::dir_of(file))?;
            OpenOptions::new().write(true).create(true).truncate(false).mode(file::PRIVATE).open(&path)
        };
        let lock = open().map_err(bad)?;
        let until = Instant::now() + LOCKED;
        loop {
            match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
                Ok(()) => return Ok(Some(lock)),
                Err(Errno::WOULDBLOCK | Errno::INTR) if Instant::now() < until => {
                    thread::sleep(Duration::from_millis(2));
                }
                Err(Errno::WOULDBLOCK) => {
                    let held = "another daemon holds the lock: try again";
                    return Err(Problem::new(Code::Store, format!("{}: {held}", path.display())));
                }
                Err(error) => return Err(bad(error.into())),
            }
        }
    }

    /// The tokens of the file as it is now; fails if the file is not used.
    fn current(&self, known: &mut FileState) -> Result<Vec<Token>, Problem> {
        self.refresh_known(known);
        match &known.problem {
            Some(problem) => Err(Problem::new(Code::Store, problem.clone())),
            None => Ok(self.tokens.load().to_vec()),
        }
    }

    fn write(&self, known: &mut FileState, tokens: &[Token]) -> Result<(), Problem> {
        let Some(file) = &self.file else { return Ok(()) };
        let bad =
            |error| Problem::new(Code::Store, format!("{}: cannot be written: {error}", file.display()));
        known.stamp = None;
        write(file, tokens).map_err(bad)?;
        // The revoked tokens are no longer in the file.
        known.revoked.clear();
        Ok(())
    }
}

/// Whether a file was changed so long ago that its next change will have another time.
fn is_settled(file: &Path) -> bool {
    let settled = |of: Metadata| {
        let changed = of.modified().ok()?;
        SystemTime::now().duration_since(changed).ok().map(|since| since >= SETTLED)
    };
    // If there is no file, any later file differs.
    fs::metadata(file).map_or(true, |of| settled(of).unwrap_or(false))
}

fn read(file: &Path) -> Result<Vec<Token>, String> {
    let bad = |what: String| format!("{}: {what}: correct or remove it", file.display());
    let bytes = match read_regular(file, MAX_FILE) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        bytes => bytes.map_err(|error| bad(error.to_string()))?,
    };
    let text = String::from_utf8(bytes).map_err(|_| bad("not UTF-8 text".to_owned()))?;
    let document: Document = toml::from_str(&text).map_err(|error| bad(error.message().to_owned()))?;
    if document.format != 1 {
        return Err(bad(format!("format {} is not known", document.format)));
    }
    let token = |row: Row| {
        let id = u32::from_str_radix(&row.id, 16).ok().map(TokenId).filter(|id| id.to_string() == row.id);
        let (id, sha256) = id
            .zip(unhex(&row.sha256))
            .ok_or_else(|| bad(format!("the token {:?} has a bad id or hash", row.name)))?;
        let Row { id: text, role, name, created, .. } = row;
        Ok(Token { id, sha256, info: TokenInfo { id: text, role, name, created } })
    };
    document.tokens.into_iter().map(token).collect()
}

fn write(file: &Path, tokens: &[Token]) -> io::Result<()> {
    let row = |token: &Token| {
        let TokenInfo { id, role, name, created } = token.info.clone();
        Row { id, role, name, created, sha256: hexadecimal(&token.sha256) }
    };
    let document = Document { format: 1, tokens: tokens.iter().map(row).collect() };
    let text = toml::to_string(&document).map_err(io::Error::other)?;
    let text = format!("# Access tokens of meissner as SHA-256 hashes: see `meissner token`.\n{text}");
    file::make_dirs(file::dir_of(file), file::PRIVATE_DIR)?;
    file::replace(file, text.as_bytes(), file::PRIVATE)
}

fn unhex(text: &str) -> Option<[u8; 32]> {
    let digits = text.as_bytes();
    if digits.len() != 64 || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    let mut bytes = [0; 32];
    for (byte, pair) in bytes.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok()?;
    }
    Some(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn tokens_outlive_the_daemon_and_their_secrets_are_nowhere() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("new/tokens.toml");
        let store = TokenStore::open(Some(file.clone()));
        let [one, two] =
            [Role::Observe, Role::Operate].map(|role| store.create(role, "a \"lab\" PC").unwrap());
        let text = fs::read_to_string(&file).unwrap();
        assert!(!text.contains(&one.token) && !text.contains(&one.token[TOKEN_PREFIX.len()..]), "{text}");
        assert_eq!(fs::metadata(&file).unwrap().permissions().mode() & 0o777, 0o600);
        let again = TokenStore::open(Some(file.clone()));
        assert_eq!(
            again.find(&one.token).map(|(id, role)| (id.to_string(), role)),
            Some((one.info.id.clone(), Role::Observe))
        );
        assert_eq!(again.list(), [one.info.clone(), two.info.clone()]);
        again.revoke(&one.info.id).unwrap();
        assert!(again.find(&one.token).is_none() && again.find(&two.token).is_some());
        assert_eq!(again.revoke(&one.info.id).unwrap_err().code, "not-found");
        assert!(!fs::read_to_string(&file).unwrap().contains(&one.info.id));
    }

    #[test]
    fn a_file_that_cannot_be_read_lets_nothing_in_and_stays() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("tokens.toml");
        let good = TokenStore::open(Some(file.clone())).create(Role::Operate, "x").unwrap();
        let text = fs::read_to_string(&file).unwrap();
        let hash = text.lines().find(|line| line.starts_with("sha256")).unwrap();
        for bad in [
            "format = 2\n".to_owned(),
            "x".to_owned(),
            text.replace(hash, "sha256 = \"00\""),
            text.replace("operate", "root"),
        ] {
            fs::write(&file, &bad).unwrap();
            let store = TokenStore::open(Some(file.clone()));
            assert!(store.find(&good.token).is_none());
            let line = store.create(Role::Operate, "y").unwrap_err().detail;
            assert!(line.contains("tokens.toml: ") && line.contains("correct or remove it"), "{line}");
            assert_eq!(fs::read_to_string(&file).unwrap(), bad);
        }
    }

    #[test]
    fn a_token_is_revoked_also_when_the_disk_fails() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("dir/tokens.toml");
        let store = TokenStore::open(Some(file.clone()));
        let token = store.create(Role::Operate, "x").unwrap();
        // A file in the place of the directory: nobody can write there, not even root.
        fs::remove_dir_all(dir.path().join("dir")).unwrap();
        fs::write(dir.path().join("dir"), "").unwrap();
        let line = store.revoke(&token.info.id).unwrap_err().detail;
        assert!(line.contains("is revoked until the daemon restarts"), "{line}");
        assert!(store.find(&token.token).is_none() && store.create(Role::Operate, "y").is_err());
        assert!(store.list().is_empty());
    }

    /// Two stores stand for two daemons with one file.
    #[test]
    fn what_one_daemon_changes_holds_in_the_other() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("tokens.toml");
        let [a, b] = [(); 2].map(|()| TokenStore::open(Some(file.clone())));
        let first = a.create(Role::Operate, "first").unwrap();
        let second = b.create(Role::Observe, "second").unwrap();
        assert!(a.refresh() && !b.refresh());
        assert_eq!(a.list(), [first.info.clone(), second.info.clone()]);
        assert_eq!(a.list(), b.list());
        a.revoke(&first.info.id).unwrap();
        assert!(b.find(&first.token).is_some() && b.refresh() && b.find(&first.token).is_none());
        // A revoked token stays revoked when the other store writes.
        let third = b.create(Role::Operate, "third").unwrap();
        a.refresh();
        assert_eq!(a.list(), [second.info.clone(), third.info.clone()]);
        // A token that only the other one has created.
        let fourth = a.create(Role::Operate, "fourth").unwrap();
        b.revoke(&fourth.info.id).unwrap();
        assert!(a.refresh() && a.find(&fourth.token).is_none());
        assert_eq!(TokenStore::open(Some(file.clone())).list(), [second.info, third.info]);
        // A missing or unreadable file admits no token; a good file does so again.
        let text = fs::read_to_string(&file).unwrap();
        fs::remove_file(&file).unwrap();
        assert!(a.refresh() && a.list().is_empty());
        fs::write(&file, "format = 9\n").unwrap();
        a.refresh();
        let line = a.create(Role::Operate, "x").unwrap_err().detail;
        assert!(line.contains("format 9 is not known"), "{line}");
        fs::write(&file, text).unwrap();
        assert!(a.refresh() && a.list().len() == 2);
    }

    #[test]
    fn daemons_that_create_at_the_same_time_lose_none() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("tokens.toml");
        let made = thread::scope(|scope| {
            let stores = [(); 4].map(|()| TokenStore::open(Some(file.clone())));
            let create = |store: TokenStore| {
                let made = (0..10).map(move |_| store.create(Role::Observe, "x").unwrap().info.id);
                scope.spawn(|| made.collect::<Vec<_>>())
            };
            stores.map(create).map(|thread| thread.join().unwrap()).concat()
        });
        let kept: Vec<_> = TokenStore::open(Some(file)).list().into_iter().map(|info| info.id).collect();
        assert_eq!(kept.len(), 40);
        assert!(made.iter().all(|id| kept.contains(id)));
    }

    #[test]
    fn a_lock_that_is_held_is_said() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("tokens.toml");
        let [a, b] = [(); 2].map(|()| TokenStore::open(Some(file.clone())));
        let token = a.create(Role::Operate, "x").unwrap();
        let held = a.lock_file().unwrap();
        let line = b.revoke(&token.info.id).unwrap_err().detail;
        assert!(line.contains("tokens.toml.lock: another daemon holds the lock"), "{line}");
        assert!(b.find(&token.token).is_none(), "it is revoked all the same");
        drop(held);
        assert!(!b.refresh() && b.find(&token.token).is_none(), "and stays so, although the file has it");
        b.create(Role::Observe, "y").unwrap();
        assert!(a.refresh() && a.find(&token.token).is_none(), "the next change writes it");
    }

    #[test]
    fn there_are_not_more_tokens_than_the_bound() {
        let store = TokenStore::open(None);
        for _ in 0..MAX_TOKENS {
            store.create(Role::Observe, "x").unwrap();
        }
        assert_eq!(store.create(Role::Observe, "x").unwrap_err().code, "exists");
    }
}
