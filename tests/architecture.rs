//! Files of a crate do not import each other in a circle, no struct has more than 16 fields, no type has its methods in more than
//! three files, and a play goes through no more files than listed here.
//!
//! Imports are read from the source with syn: `use`, and paths in code, each followed through re-exports to the file that defines the
//! item. What only tests use does not count.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use syn::visit::{self, Visit};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Where the workspace has source folders.
const GROUPS: [&str; 5] = ["", "crates", "tests", "firmware", "verify"];

/// Modules in a circle with what they hand on, which are to be parted.
const HIDDEN: [&str; 2] = ["control::burst_controller", "device::usb"];

type Module = Vec<String>;

/// The source folders of all crates, and what is in them.
static CRATES: LazyLock<Vec<(PathBuf, Sources)>> =
    LazyLock::new(|| sources().into_iter().map(|src| (src.clone(), Sources::read(&src))).collect());

fn sources() -> Vec<PathBuf> {
    let folders = GROUPS.map(|group| Path::new(ROOT).join(group)).into_iter().flat_map(|group| {
        let inner = fs::read_dir(&group).unwrap().map(|entry| entry.unwrap().path());
        inner.chain([group]).collect::<Vec<_>>()
    });
    let sources: BTreeSet<_> = folders.map(|folder| folder.join("src")).filter(|src| src.is_dir()).collect();
    sources.into_iter().collect()
}

/// The modules of a crate and their files. A program's `main.rs` stands above all of them.
fn modules(folder: &Path, prefix: &Module, found: &mut BTreeMap<Module, PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_stem().unwrap().to_str().unwrap().to_owned();
        let inner = |name| prefix.iter().cloned().chain([name]).collect();
        if path.is_dir() {
            modules(&path, &inner(name), found);
        } else if path.extension().is_some_and(|extension| extension == "rs") && name != "main" {
            let module = if name == "mod" || name == "lib" { prefix.clone() } else { inner(name) };
            found.insert(module, path);
        }
    }
}

/// Paths that a file names within its crate, modules that only tests have, what names of other modules it has, and its types.
#[derive(Default)]
struct Names {
    module: Module,
    /// Its modules with files of their own.
    children: BTreeSet<String>,
    paths: Vec<Module>,
    imported: BTreeMap<String, Module>,
    /// The names that it hands on: one that it uses itself, too, is imported.
    handed_on: BTreeMap<String, Module>,
    test_modules: Vec<Module>,
    /// Types with methods here.
    methods: BTreeSet<Module>,
    /// Structs and how many fields they have.
    structs: Vec<(String, usize)>,
}

impl Names {
    /// The path from the crate's root, if it lies in the crate.
    fn resolve(&self, path: &[String]) -> Option<Module> {
        let above = self.module.len().saturating_sub(1);
        let (base, rest) = match path.first()?.as_str() {
            "crate" => (&[][..], &path[1..]),
            "self" => (&self.module[..], &path[1..]),
            "super" => (&self.module[..above], &path[1..]),
            child if path.len() > 1 && self.children.contains(child) => (&self.module[..], path),
            _ => return None,
        };
        Some([base, rest].concat())
    }

    fn tree(&mut self, tree: &syn::UseTree, so_far: &mut Module, handed_on: bool) {
        let leaf = match tree {
            syn::UseTree::Path(path) => {
                so_far.push(path.ident.to_string());
                self.tree(&path.tree, so_far, handed_on);
                so_far.pop();
                return;
            }
            syn::UseTree::Group(group) => {
                return group.items.iter().for_each(|item| self.tree(item, so_far, handed_on));
            }
            syn::UseTree::Name(name) => Some((name.ident.to_string(), name.ident.to_string())),
            syn::UseTree::Rename(name) => Some((name.ident.to_string(), name.rename.to_string())),
            syn::UseTree::Glob(_) => None,
        };
        let path: Module =
            so_far.iter().cloned().chain(leaf.as_ref().map(|(name, _)| name.clone())).collect();
        let Some(whole) = self.resolve(&path) else { return };
        if let Some((_, alias)) = leaf {
            self.imported.insert(alias.clone(), whole.clone());
            if handed_on {
                self.handed_on.insert(alias, whole.clone());
            }
        }
        if !handed_on {
            self.paths.push(whole);
        }
    }
}

/// Whether only tests have it, or tests, the fuzzer and the bench.
fn is_for_tests(attributes: &[syn::Attribute]) -> bool {
    let is_test = |attribute: &syn::Attribute| {
        let names_test = |meta: &syn::Meta| match meta {
            syn::Meta::Path(path) => path.is_ident("test"),
            syn::Meta::List(list) if list.path.is_ident("any") => {
                list.tokens.clone().into_iter().any(|token| token.to_string() == "test")
            }
            _ => false,
        };
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Meta>().is_ok_and(|argument| names_test(&argument))
    };
    attributes.iter().any(is_test)
}

impl<'ast> Visit<'ast> for Names {
    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        if !is_for_tests(&item.attrs) {
            return visit::visit_item_mod(self, item);
        }
        let name = item.ident.to_string();
        self.test_modules.push(self.module.iter().cloned().chain([name]).collect());
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if !is_for_tests(&item.attrs) {
            let handed_on = !matches!(item.vis, syn::Visibility::Inherited);
            self.tree(&item.tree, &mut Module::new(), handed_on);
        }
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        if !is_for_tests(&item.attrs) {
            self.structs.push((item.ident.to_string(), item.fields.len()));
            visit::visit_item_struct(self, item);
        }
    }

    fn visit_item_impl(&mut self, item: &'ast syn::ItemImpl) {
        if is_for_tests(&item.attrs) {
            return;
        }
        if let (None, syn::Type::Path(of)) = (&item.trait_, &*item.self_ty) {
            let name: Module = of.path.segments.iter().map(|segment| segment.ident.to_string()).collect();
            let here = || [&self.module[..], &name[..]].concat();
            let path = self.resolve(&name).or_else(|| self.imported.get(&name[0]).cloned());
            self.methods.insert(path.unwrap_or_else(here));
        }
        visit::visit_item_impl(self, item);
    }

    /// `pub(in crate::x)` imports nothing.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Module = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.paths.extend(self.resolve(&names).or_else(|| {
            let is_known = HIDDEN.contains(&&*self.module.join("::"));
            self.handed_on.get(&names[0]).filter(|_| !is_known).cloned()
        }));
        visit::visit_path(self, path);
    }
}

/// The files of a crate's product, and the names in them.
struct Sources {
    files: BTreeMap<Module, PathBuf>,
    names: BTreeMap<Module, Names>,
}

impl Sources {
    fn read(src: &Path) -> Self {
        let mut files = BTreeMap::new();
        modules(src, &Module::new(), &mut files);
        let read = |(module, file): (&Module, &PathBuf)| {
            let inner = files.keys().filter(|of| of.len() == module.len() + 1 && of.starts_with(module));
            let children = inner.map(|of| of[module.len()].clone()).collect();
            let mut names = Names { module: module.clone(), children, ..Names::default() };
            names.visit_file(&syn::parse_file(&fs::read_to_string(file).unwrap()).unwrap());
            (module.clone(), names)
        };
        let mut names: BTreeMap<Module, Names> = files.iter().map(read).collect();
        let for_tests: Vec<_> = names.values().flat_map(|names| names.test_modules.clone()).collect();
        names.retain(|module, _| !for_tests.iter().any(|test| module.starts_with(test)));
        files.retain(|module, _| names.contains_key(module));
        Self { files, names }
    }

    /// The path of what a path names, from the module that defines it: a module hands on names of others.
    fn defined(&self, path: &Module) -> Option<(&PathBuf, Module)> {
        let mut path = path.clone();
        for _ in 0..8 {
            let len = (0..=path.len()).rev().find(|len| self.files.contains_key(&path[..*len]))?;
            match path.get(len).and_then(|item| self.names[&path[..len]].imported.get(item)) {
                Some(next) => path.clone_from(next),
                None => return Some((&self.files[&path[..len]], path)),
            }
        }
        None
    }

    /// Which file imports which.
    fn imports(&self) -> BTreeMap<PathBuf, BTreeSet<PathBuf>> {
        let of = |(module, names): (&Module, &Names)| {
            let owners = names.paths.iter().filter_map(|path| self.defined(path));
            let mut others: BTreeSet<_> = owners.map(|(file, _)| file.clone()).collect();
            others.remove(&self.files[module]);
            (self.files[module].clone(), others)
        };
        self.names.iter().map(of).collect()
    }

    /// The files in which a type has methods.
    fn files_of_methods(&self) -> BTreeMap<Module, BTreeSet<&PathBuf>> {
        let mut found = BTreeMap::<_, BTreeSet<_>>::new();
        for (module, names) in &self.names {
            for path in &names.methods {
                let (_, defined) = self.defined(path).unwrap();
                found.entry(defined).or_default().insert(&self.files[module]);
            }
        }
        found
    }
}

/// What is left once the files that import none of the rest, or that none of the rest imports, are taken away.
fn circles(mut imports: BTreeMap<PathBuf, BTreeSet<PathBuf>>) -> BTreeMap<PathBuf, BTreeSet<PathBuf>> {
    loop {
        let before = imports.len();
        let imported: BTreeSet<_> = imports.values().flatten().cloned().collect();
        imports.retain(|file, others| !others.is_empty() && imported.contains(file));
        let left: BTreeSet<_> = imports.keys().cloned().collect();
        imports.values_mut().for_each(|others| others.retain(|other| left.contains(other)));
        if imports.len() == before {
            return imports;
        }
    }
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    assert!(CRATES.len() > 15, "{} crates", CRATES.len());
    // The controller's are to be parted without changing what the chip does: see `docs/dev/decisions.md`.
    let is_known = |file: &PathBuf| file.to_string_lossy().contains("firmware-protocol/src/controller/");
    let found = CRATES.iter().flat_map(|(_, of)| circles(of.imports()));
    let found: Vec<_> = found.filter(|(file, _)| !is_known(file)).collect();
    let lines: Vec<String> =
        found.iter().map(|(file, others)| format!("{file:?} imports {others:?}")).collect();
    assert!(lines.is_empty(), "circles of imports:\n{}", lines.join("\n").replace(&format!("{ROOT}/"), ""));
}

/// Structs with more fields than 16, which are to become smaller.
const LARGE: &[&str] = &["RawConfig", "Player"];

/// The crates of the product.
fn product() -> impl Iterator<Item = &'static Sources> {
    let beside = ["tests", "verify", "uf2"].map(|folder| format!("/{folder}/"));
    let is_product = move |src: &Path| !beside.iter().any(|folder| src.to_string_lossy().contains(folder));
    CRATES.iter().filter(move |(src, _)| is_product(src)).map(|(_, of)| of)
}

#[test]
fn no_struct_has_more_than_16_fields() {
    let structs = product().flat_map(|of| of.names.values()).flat_map(|names| &names.structs);
    let large: Vec<_> = structs.filter(|(name, fields)| *fields > 16 && !LARGE.contains(&&**name)).collect();
    assert!(large.is_empty(), "structs with more than 16 fields: {large:?}");
}

#[test]
fn no_type_has_methods_in_more_than_three_files() {
    let types = product().flat_map(Sources::files_of_methods);
    let scattered: Vec<_> = types
        .filter(|(path, files)| files.len() > 3 && path.last().is_none_or(|name| name != "Player"))
        .collect();
    assert!(scattered.is_empty(), "types with methods in more than three files: {scattered:?}");
}

/// The way of `POST /v1/play` from the client's bytes to the device's: each file that has the play in hand, with the function that takes it
/// and passes it on. What is only asked about it (gate, rights, limits, receipts, record, patterns) is not on the way.
const WALK: &[(&str, &str)] = &[
    ("src/daemon/net/server.rs", "serve_client"),
    ("src/daemon/net/client.rs", "poll_frame"),
    ("src/daemon/net/admission.rs", "layer"),
    ("src/daemon/net/admission.rs", "guard"),
    ("src/daemon/plays/handlers.rs", "play"),
    ("src/daemon/net/body.rs", "read_file"),
    ("src/daemon/plays/order.rs", "play"),
    ("src/daemon/plays/order.rs", "of_order"),
    ("src/daemon/plays/begin.rs", "begin"),
    ("src/daemon/core/state.rs", "send"),
    ("src/daemon/core/commands.rs", "send"),
    ("crates/stream/src/queues/mod.rs", "pop"),
    ("crates/stream/src/thread.rs", "execute_requests"),
    ("crates/stream/src/streamer/commands.rs", "play"),
    ("crates/stream/src/streamer/mod.rs", "step"),
    ("crates/stream/src/streamer/feed.rs", "send_steps"),
    ("crates/stream/src/active/mod.rs", "next_step"),
    ("crates/stream/src/source.rs", "next"),
    ("crates/stream/src/link/session/mod.rs", "push"),
    ("crates/stream/src/link/session/outbox.rs", "write_next"),
    ("crates/stream/src/link/session/batch.rs", "write"),
    ("crates/stream/src/link/session/outbound.rs", "transmit"),
];
/// Files on the way down to the link, and with those of the link. The goal is 15 for all.
const FILES: [usize; 2] = [17, 20];
/// What the play is on the way, one after the other, and the file that has each.
const TYPES: [(&str, &str); 4] = [
    ("crates/api/src/order.rs", "Order"),
    ("src/daemon/plays/begin.rs", "Compiled"),
    ("crates/stream/src/queues/play.rs", "Play"),
    ("crates/stream/src/active/mod.rs", "Active"),
];

/// The functions and structs that a file defines.
#[derive(Default)]
struct Defined(BTreeSet<String>);

impl<'ast> Visit<'ast> for Defined {
    fn visit_signature(&mut self, signature: &'ast syn::Signature) {
        self.0.insert(signature.ident.to_string());
    }

    fn visit_item_struct(&mut self, item: &'ast syn::ItemStruct) {
        self.0.insert(item.ident.to_string());
    }
}

#[test]
fn a_play_goes_through_few_files_and_types() {
    for (file, name) in WALK.iter().chain(&TYPES) {
        let text = fs::read_to_string(Path::new(ROOT).join(file)).unwrap_or_default();
        let mut defined = Defined::default();
        defined.visit_file(&syn::parse_file(&text).unwrap());
        assert!(defined.0.contains(*name), "{file} has no `{name}`: correct the way of a play");
        assert!(text.lines().count() <= 520, "{file} is longer than 520 lines");
    }
    let files = |link: bool| -> BTreeSet<_> {
        let inner = |file: &str| !link && file.contains("/link/session/") && !file.ends_with("mod.rs");
        WALK.iter().map(|(file, _)| *file).filter(|file| !inner(file)).collect()
    };
    assert!(files(false).len() <= FILES[0], "{:?}", files(false));
    assert!(files(true).len() <= FILES[1], "{:?}", files(true));
}
