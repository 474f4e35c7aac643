//! The access tokens: creates, revokes and finds them, and keeps their hashes in a file.
//!
//! A token holds 256 random bits, so its SHA-256 needs no salt and cannot be guessed. The store compares a token with all valid
//! ones in constant time. The file is replaced atomically, and only the daemon's user can read it.
//!
//! A daemon that has tokens in a file holds a lock beside it (`.lock`), so that two daemons with one
//! file do not undo each other's changes.
//!
//! Invariant: a file that cannot be read or locked admits no token, and is not overwritten.

use crate::clock::utc_text;
use crate::file::{self, read_regular};
use crate::record::TokenId;
use crate::store::hexadecimal;
use arc_swap::ArcSwap;
use meissner_api::{Code, MAX_TOKENS, Problem, Role, TOKEN_PREFIX, TokenCreated, TokenInfo};
use meissner_stream::time::random;
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use subtle::{Choice, ConditionallySelectable, ConstantTimeEq};
use tracing::warn;

/// Characters of a token.
const LENGTH: usize = TOKEN_PREFIX.len() + 64;
/// The most bytes of the file.
const MAX_FILE: u64 = 1 << 20;

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

/// How the file stands.
#[derive(Debug, Default)]
struct FileState {
    /// Why the file is not used.
    problem: Option<String>,
    /// The lock beside it, once the file is there.
    lock: Option<File>,
}

impl TokenStore {
    /// Reads the tokens of the file. If the file cannot be read, the log says so, and no token is valid.
    pub(in crate::daemon) fn open(file: Option<PathBuf>) -> Self {
        let mut state = FileState::default();
        let tokens = match &file {
            Some(file) if file.exists() => state.take(file).unwrap_or_else(|problem| {
                warn!("{problem}: no access token is valid");
                state.problem = Some(problem);
                Vec::new()
            }),
            _ => Vec::new(),
        };
        Self { file, tokens: ArcSwap::from_pointee(tokens), changing: Mutex::new(state) }
    }

    /// Makes the heap allocations that the first look-up of a thread needs.
    pub(in crate::daemon) fn prepare_thread(&self) {
        drop(self.tokens.load());
    }

    /// The id and role of a token, if it is valid. Uses no heap on a prepared thread.
    pub(in crate::daemon) fn find(&self, token: &str) -> Option<(TokenId, Role)> {
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
        if !random(&mut bytes) {
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
        let info = TokenInfo { id: id.to_string(), role, name: name.to_owned(), created: utc_text() };
        let sha256 = Sha256::digest(&token).into();
        let mut state = self.lock();
        let mut tokens = self.current(&mut state)?;
        if tokens.len() >= MAX_TOKENS {
            let detail =
                format!("there are {MAX_TOKENS} tokens already: revoke one with `meissner token revoke ID`");
            return Err(Problem::new(Code::Exists, detail));
        }
        if tokens.iter().any(|token| token.id == id) {
            return Err(Problem::new(Code::Exists, "the token's id is taken by chance: create it again"));
        }
        tokens.push(Token { id, sha256, info: info.clone() });
        self.write(&tokens)?;
        self.tokens.store(Arc::new(tokens));
        Ok(TokenCreated { info, token })
    }

    /// Revokes a token, at once; then waits for the disk.
    pub(in crate::daemon) fn revoke(&self, id: &str) -> Result<TokenInfo, Problem> {
        let mut state = self.lock();
        let mut tokens = self.tokens.load().to_vec();
        let Some(place) = tokens.iter().position(|token| token.info.id == id) else {
            return Err(match &state.problem {
                Some(problem) => Problem::new(Code::Store, problem),
                None => {
                    Problem::new(Code::NotFound, format!("there is no token {id}: see `meissner token list`"))
                }
            });
        };
        // Revoke it in memory first: a full disk must not keep a token valid.
        let revoked = tokens.remove(place).info;
        self.tokens.store(Arc::new(tokens));
        let written = self.current(&mut state).and_then(|tokens| self.write(&tokens));
        written.map_err(|problem| {
            let detail = format!("{}; token {id} is revoked until the daemon restarts", problem.detail);
            Problem::new(Code::Store, detail)
        })?;
        Ok(revoked)
    }

    /// Locks out other changes.
    fn lock(&self) -> MutexGuard<'_, FileState> {
        self.changing.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The tokens to change; fails if the file is not used. The first change takes the file.
    fn current(&self, state: &mut FileState) -> Result<Vec<Token>, Problem> {
        if let Some(problem) = &state.problem {
            return Err(Problem::new(Code::Store, problem.clone()));
        }
        if let (Some(file), None) = (&self.file, &state.lock) {
            // Another daemon may have made it meanwhile.
            let found = state.take(file).map_err(|problem| Problem::new(Code::Store, problem))?;
            self.tokens.store(Arc::new(found));
        }
        Ok(self.tokens.load().to_vec())
    }

    fn write(&self, tokens: &[Token]) -> Result<(), Problem> {
        let Some(file) = &self.file else { return Ok(()) };
        let bad =
            |error| Problem::new(Code::Store, format!("{}: cannot be written: {error}", file.display()));
        write(file, tokens).map_err(bad)
    }
}

impl FileState {
    /// Locks out other daemons until the end of this one, and reads the tokens of the file, if there is one.
    fn take(&mut self, file: &Path) -> Result<Vec<Token>, String> {
        let path = file.with_added_extension("lock");
        let bad = |error: io::Error| format!("{}: cannot be locked: {error}", path.display());
        let open = || {
            file::make_dirs(file::dir_of(file), file::PRIVATE_DIR)?;
            OpenOptions::new().write(true).create(true).truncate(false).mode(file::PRIVATE).open(&path)
        };
        let lock = open().map_err(bad)?;
        match flock(&lock, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => {
                let file = file.display();
                return Err(format!(
                    "{file}: another daemon uses it: name another file with `tokens` in the configuration"
                ));
            }
            Err(error) => return Err(bad(error.into())),
        }
        let tokens = read(file)?;
        self.lock = Some(lock);
        Ok(tokens)
    }
}

fn read(file: &Path) -> Result<Vec<Token>, String> {
    let bad = |what: String| {
        format!("{}: {what}: correct or remove it, and start the daemon again", file.display())
    };
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
        drop(store);
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
    fn a_second_daemon_with_the_file_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("tokens.toml");
        let [first, second] = [(); 2].map(|()| TokenStore::open(Some(file.clone())));
        let token = first.create(Role::Operate, "first").unwrap();
        let text = fs::read_to_string(&file).unwrap();
        for store in [second, TokenStore::open(Some(file.clone()))] {
            let line = store.create(Role::Observe, "second").unwrap_err().detail;
            assert!(line.contains("tokens.toml: another daemon uses it: name another file"), "{line}");
            assert!(store.find(&token.token).is_none() && store.list().is_empty());
        }
        assert_eq!(fs::read_to_string(&file).unwrap(), text);
        drop(first);
        assert!(TokenStore::open(Some(file)).find(&token.token).is_some());
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
