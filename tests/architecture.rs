//! Files of a crate do not import each other in a circle.
//!
//! Imports are read from the source with syn: `use`, and paths in code. What only tests use does not count.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::visit::{self, Visit};

const ROOT: &str = env!("CARGO_MANIFEST_DIR");
/// Where the workspace has source folders.
const GROUPS: [&str; 4] = ["", "crates", "tests", "firmware"];

type Module = Vec<String>;

/// The source folders of all crates.
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

/// Paths that a file names within its crate, modules that only tests have, and what it hands on of other modules.
#[derive(Default)]
struct Names {
    module: Module,
    paths: Vec<Module>,
    handed_on: BTreeMap<String, Module>,
    test_modules: Vec<Module>,
}

impl Names {
    /// The path from the crate's root, if it lies in the crate.
    fn resolve(&self, path: &[String]) -> Option<Module> {
        let above = self.module.len().saturating_sub(1);
        let (base, rest) = match path.first()?.as_str() {
            "crate" => (&[][..], &path[1..]),
            "self" => (&self.module[..], &path[1..]),
            "super" => (&self.module[..above], &path[1..]),
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
        if let (true, Some((_, alias))) = (handed_on, leaf) {
            // `pub use child::Item`: the path begins here.
            let whole = self.resolve(&path).unwrap_or_else(|| [&self.module[..], &path[..]].concat());
            self.handed_on.insert(alias, whole);
        } else if let Some(path) = self.resolve(&path) {
            self.paths.push(path);
        }
    }
}

fn is_for_tests(attributes: &[syn::Attribute]) -> bool {
    let is_test = |attribute: &syn::Attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Path>().is_ok_and(|argument| argument.is_ident("test"))
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

    /// `pub(in crate::x)` imports nothing.
    fn visit_visibility(&mut self, _: &'ast syn::Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        let names: Module = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        self.paths.extend(self.resolve(&names));
        visit::visit_path(self, path);
    }
}

/// Which file of a crate imports which.
fn imports(src: &Path) -> BTreeMap<PathBuf, BTreeSet<PathBuf>> {
    let mut files = BTreeMap::new();
    modules(src, &Module::new(), &mut files);
    let read = |(module, file): (&Module, &PathBuf)| {
        let mut names = Names { module: module.clone(), ..Names::default() };
        names.visit_file(&syn::parse_file(&fs::read_to_string(file).unwrap()).unwrap());
        (module.clone(), names)
    };
    let names: BTreeMap<Module, Names> = files.iter().map(read).collect();
    let for_tests: Vec<_> = names.values().flat_map(|names| &names.test_modules).collect();
    // The file that defines what a path names: a module hands on names of others.
    let owner = |path: &Module| {
        let mut path = path.clone();
        for _ in 0..8 {
            let len = (0..=path.len()).rev().find(|len| files.contains_key(&path[..*len]))?;
            let item = path.get(len);
            match item.and_then(|item| names[&path[..len]].handed_on.get(item)) {
                Some(next) => path.clone_from(next),
                None => return Some(files[&path[..len]].clone()),
            }
        }
        None
    };
    let product = names.iter().filter(|(module, _)| !for_tests.iter().any(|test| module.starts_with(test)));
    product
        .map(|(module, names)| {
            let mut others: BTreeSet<_> = names.paths.iter().filter_map(owner).collect();
            others.remove(&files[module]);
            (files[module].clone(), others)
        })
        .collect()
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
    let sources = sources();
    assert!(sources.len() > 15, "{sources:?}");
    let found: Vec<_> = sources.iter().flat_map(|src| circles(imports(src))).collect();
    let lines: Vec<String> =
        found.iter().map(|(file, others)| format!("{file:?} imports {others:?}")).collect();
    assert!(lines.is_empty(), "circles of imports:\n{}", lines.join("\n").replace(&format!("{ROOT}/"), ""));
}

/// What a room does with the shared state is a function of the room, so that the state stays readable in one place.
#[test]
fn what_all_rooms_share_is_extended_in_few_files() {
    let mut files = BTreeMap::new();
    modules(&Path::new(ROOT).join("src/daemon"), &Module::new(), &mut files);
    let extends = |name: &str| {
        let is_impl = |item: &syn::Item| match item {
            syn::Item::Impl(block) if block.trait_.is_none() => {
                matches!(&*block.self_ty, syn::Type::Path(of) if of.path.is_ident(name))
            }
            _ => false,
        };
        let has = |file: &&PathBuf| {
            syn::parse_file(&fs::read_to_string(file).unwrap()).unwrap().items.iter().any(is_impl)
        };
        files.values().filter(has).collect::<Vec<_>>()
    };
    for (name, most) in [("Engine", 3), ("State", 8)] {
        let found = extends(name);
        assert!((1..=most).contains(&found.len()), "impl {name} stands in {found:?}");
    }
}
