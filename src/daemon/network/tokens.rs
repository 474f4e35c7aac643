//! The access tokens: created, revoked, found again, and kept as hashes in a file.
//!
//! A token holds 256 random bits, so its SHA-256 needs no salt and cannot be guessed. The store compares a token with all valid ones in
//! constant time. The file is replaced whole or not at all, and only the daemon's user reads it.
//!
//! Invariant: a file that cannot be read lets no token in, and is not overwritten.

use crate::daemon::calibration::utc_now;
use crate::file::{self, read_regular};
use crate::session_record::TokenId;
use crate::store::hexadecimal;
use arc_swap::ArcSwap;
use meissner_api::{Code, MAX_TOKENS, Problem, Role, TOKEN_PREFIX, TokenCreated, TokenInfo};
use rustix::rand::{GetRandomFlags, getrandom};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::io;
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
    /// Where tokens are kept; without it they end with the daemon.
    file: Option<PathBuf>,
    tokens: ArcSwap<Vec<Token>>,
    /// Why the file is not used. Held while tokens change.
    changing: Mutex<Option<String>>,
}

impl TokenStore {
    /// Reads the tokens of the file. A file that cannot be read is in the log, and no token is valid.
    pub(in crate::daemon) fn open(file: Option<PathBuf>) -> Self {
        let (tokens, problem) = match file.as_deref().map_or(Ok(Vec::new()), read) {
            Ok(tokens) => (tokens, None),
            Err(problem) => {
                warn!("{problem}: no access token is valid");
                (Vec::new(), Some(problem))
            }
        };
        Self { file, tokens: ArcSwap::from_pointee(tokens), changing: Mutex::new(problem) }
    }

    /// Makes what the first look-up of a thread needs on the heap.
    pub(in crate::daemon) fn prepare_thread(&self) {
        drop(self.tokens.load());
    }

    /// The id and role of a token, if it is valid. Uses no heap on a thread that is prepared.
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
        let changing = self.lock()?;
        let mut tokens = self.tokens.load().to_vec();
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
        drop(changing);
        Ok(TokenCreated { info, token })
    }

    /// Revokes a token, at once; then waits for the disk.
    pub(in crate::daemon) fn revoke(&self, id: &str) -> Result<TokenInfo, Problem> {
        let changing = self.lock()?;
        let mut tokens = self.tokens.load().to_vec();
        let at = tokens.iter().position(|token| token.info.id == id);
        let none =
            || Problem::new(Code::NotFound, format!("there is no token {id}: see `meissner token list`"));
        let revoked = tokens.remove(at.ok_or_else(none)?).info;
        // For clients first: a full disk must not keep a token valid.
        self.tokens.store(Arc::new(tokens.clone()));
        self.write(&tokens).map_err(|problem| {
            let detail = format!("{}; token {id} is revoked until the daemon restarts", problem.detail);
            Problem::new(Code::Store, detail)
        })?;
        drop(changing);
        Ok(revoked)
    }

    /// Holds changes back; fails if the file is not used.
    fn lock(&self) -> Result<MutexGuard<'_, Option<String>>, Problem> {
        let problem = self.changing.lock().unwrap_or_else(PoisonError::into_inner);
        match &*problem {
            Some(problem) => Err(Problem::new(Code::Store, format!("{problem}, then restart the daemon"))),
            None => Ok(problem),
        }
    }

    fn write(&self, tokens: &[Token]) -> Result<(), Problem> {
        let Some(file) = &self.file else { return Ok(()) };
        let bad =
            |error| Problem::new(Code::Store, format!("{}: cannot be written: {error}", file.display()));
        write(file, tokens).map_err(bad)
    }
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

    #[test]
    fn there_are_not_more_tokens_than_the_bound() {
        let store = TokenStore::open(None);
        for _ in 0..MAX_TOKENS {
            store.create(Role::Observe, "x").unwrap();
        }
        assert_eq!(store.create(Role::Observe, "x").unwrap_err().code, "exists");
    }
}
