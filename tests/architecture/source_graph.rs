//! Which source file of a crate takes names from which other one.
//!
//! An arrow is a path in the code whose name another file of the same crate defines. `mod x;` is no arrow, a `pub use`
//! forwards to the file that defines the name, and code under `#[cfg(test)]` may look wherever it likes.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use petgraph::algo::tarjan_scc;
use petgraph::graph::DiGraph;
use proc_macro2::{TokenStream, TokenTree};
use syn::visit::{self, Visit};
use syn::{Attribute, Item, UseTree, Visibility};

/// Names of modules from the crate's root down.
type ModulePath = Vec<String>;

/// What a module declares.
struct Module {
    file: usize,
    defined: BTreeSet<String>,
    /// Names that a `use` brings in, with the path that it gives.
    imported: BTreeMap<String, Vec<String>>,
    /// Paths of `use x::*`.
    globs: Vec<Vec<String>>,
}

/// A path as it stands in the code.
struct Reference {
    file: usize,
    module: ModulePath,
    segments: Vec<String>,
    is_use: bool,
}

/// The source files of a crate and the arrows between them.
pub struct SourceGraph {
    files: Vec<PathBuf>,
    modules: BTreeMap<ModulePath, Module>,
    arrows: BTreeMap<(usize, usize), BTreeSet<String>>,
}

impl SourceGraph {
    /// Reads a crate from its root file on.
    ///
    /// Panics, naming the file, where one cannot be read or is no Rust.
    pub fn read(root: &Path) -> Self {
        let mut graph = Self { files: Vec::new(), modules: BTreeMap::new(), arrows: BTreeMap::new() };
        let mut references = Vec::new();
        graph.load(root, root.parent().expect("a file is in a folder"), Vec::new(), &mut references);
        for reference in &references {
            let Some((to, name)) = graph.resolve(reference) else { continue };
            if to != reference.file {
                graph.arrows.entry((reference.file, to)).or_default().insert(name);
            }
        }
        graph
    }

    /// The circles: for each, its arrows as `file -> file: names`.
    pub fn circles(&self) -> Vec<Vec<String>> {
        let mut graph = DiGraph::<(), ()>::new();
        let nodes: Vec<_> = self.files.iter().map(|_| graph.add_node(())).collect();
        for (from, to) in self.arrows.keys() {
            graph.add_edge(nodes[*from], nodes[*to], ());
        }
        let circles = tarjan_scc(&graph).into_iter().filter(|files| files.len() > 1);
        circles
            .map(|files| {
                let inside = |file: &usize| files.contains(&nodes[*file]);
                let arrows = self.arrows.iter().filter(|((from, to), _)| inside(from) && inside(to));
                arrows.map(|((from, to), names)| self.arrow(*from, *to, names)).collect()
            })
            .collect()
    }

    fn arrow(&self, from: usize, to: usize, names: &BTreeSet<String>) -> String {
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        format!("{} -> {}: {}", self.files[from].display(), self.files[to].display(), names.join(", "))
    }

    /// Reads a file and those of the modules that it declares; theirs are in `folder`.
    fn load(&mut self, path: &Path, folder: &Path, module: ModulePath, references: &mut Vec<Reference>) {
        let text = std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let parsed = syn::parse_file(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let file = self.files.len();
        self.files.push(path.into());
        let mut reader = Reader { graph: self, file, folder: folder.into(), module, references };
        reader.module_items(&parsed.items);
    }

    /// The file that defines what a reference names, and the name.
    fn resolve(&self, reference: &Reference) -> Option<(usize, String)> {
        let Reference { module, segments, is_use, .. } = reference;
        // One word in an expression is a variable, or a name that the module has; never a module.
        if let [name] = &segments[..]
            && !is_use
            && !self.has_item(module, name)
        {
            return None;
        }
        self.target(module, segments, 0)
    }

    /// The file that defines what a path in `module` names, and the name; `None` for other crates and local names.
    fn target(&self, module: &[String], segments: &[String], depth: usize) -> Option<(usize, String)> {
        // Two modules that import each other's names in a ring define nothing.
        if depth > 16 {
            return None;
        }
        let (first, rest) = segments.split_first()?;
        match first.as_str() {
            "crate" => self.named_in(&[], rest, depth),
            "self" => self.named_in(module, rest, depth),
            "super" => {
                let (_, parent) = module.split_last()?;
                match rest.first() {
                    Some(next) if next == "super" => self.target(parent, rest, depth + 1),
                    _ => self.named_in(parent, rest, depth),
                }
            }
            _ if self.declares(module, first) => self.named_in(module, segments, depth),
            _ => None,
        }
    }

    /// Whether a module has a name of its own crate by that spelling.
    fn declares(&self, module: &[String], name: &str) -> bool {
        self.has_item(module, name) || self.modules.contains_key(&child(module, name))
    }

    /// Whether a module defines or imports a name.
    fn has_item(&self, module: &[String], name: &str) -> bool {
        let declared = &self.modules[module];
        declared.defined.contains(name)
            || declared.imported.contains_key(name)
            || declared.globs.iter().any(|glob| self.is_in_glob(module, glob, name))
    }

    fn is_in_glob(&self, module: &[String], glob: &[String], name: &str) -> bool {
        // A glob of a parent would ask the parent's globs in turn; one level is what the tree uses.
        let named = self.module_at(module, glob);
        named.is_some_and(|m| {
            self.modules[&m].defined.contains(name) || self.modules[&m].imported.contains_key(name)
        })
    }

    /// The module of this crate that a path names.
    fn module_at(&self, module: &[String], path: &[String]) -> Option<ModulePath> {
        let mut at = match path.first().map(String::as_str) {
            Some("crate") => Vec::new(),
            Some("self" | "super") => module.to_vec(),
            _ => child(module, path.first()?),
        };
        for (n, segment) in path.iter().enumerate() {
            match segment.as_str() {
                "super" => drop(at.pop()?),
                "crate" | "self" => {}
                _ if n == 0 => {}
                name => at.push(name.into()),
            }
        }
        self.modules.contains_key(&at).then_some(at)
    }

    /// The file that defines `segments` seen from inside `module`.
    fn named_in(&self, module: &[String], segments: &[String], depth: usize) -> Option<(usize, String)> {
        let declared = self.modules.get(module)?;
        let Some((first, rest)) = segments.split_first() else {
            return Some((declared.file, module.last().cloned().unwrap_or_default()));
        };
        if declared.defined.contains(first) {
            return Some((declared.file, first.clone()));
        }
        let inner = child(module, first);
        if self.modules.contains_key(&inner) {
            return self.named_in(&inner, rest, depth + 1);
        }
        if let Some(path) = declared.imported.get(first) {
            let whole: Vec<String> = path.iter().chain(rest).cloned().collect();
            // `use x::x;` in the module that has `mod x;` must not ask itself.
            return self.target(module, &whole, depth + 1);
        }
        for glob in &declared.globs {
            if self.is_in_glob(module, glob, first) {
                let whole: Vec<String> = glob.iter().chain(segments).cloned().collect();
                return self.target(module, &whole, depth + 1);
            }
        }
        // A name that only a macro makes.
        Some((declared.file, first.clone()))
    }
}

fn child(module: &[String], name: &str) -> ModulePath {
    module.iter().cloned().chain([name.to_string()]).collect()
}

/// Collects declarations and references of one file.
struct Reader<'a> {
    graph: &'a mut SourceGraph,
    file: usize,
    folder: PathBuf,
    module: ModulePath,
    references: &'a mut Vec<Reference>,
}

impl Reader<'_> {
    /// The items of a module, which is a file or a block in one.
    fn module_items(&mut self, items: &[Item]) {
        let (defined, imported, globs) = Default::default();
        let mut declared = Module { file: self.file, defined, imported, globs };
        for item in items.iter().filter(|item| !is_test(attributes(item))) {
            if let Some(name) = defined_name(item) {
                declared.defined.insert(name);
            }
            if let Item::Use(item) = item {
                for (path, name) in flat(&item.tree, Vec::new()) {
                    match name {
                        Some(name) => drop(declared.imported.insert(name, path)),
                        None => declared.globs.push(path),
                    }
                }
            }
        }
        self.graph.modules.insert(self.module.clone(), declared);
        for item in items {
            self.visit_item(item);
        }
    }

    fn reference(&mut self, segments: Vec<String>, is_use: bool) {
        self.references.push(Reference { file: self.file, module: self.module.clone(), segments, is_use });
    }

    /// Paths inside a macro, whose tokens are no syntax tree.
    fn tokens(&mut self, tokens: TokenStream) {
        let mut path: Vec<String> = Vec::new();
        let mut colons = 2;
        for token in tokens {
            match token {
                TokenTree::Ident(name) if colons == 2 || path.is_empty() => {
                    path.push(name.to_string());
                    colons = 0;
                }
                TokenTree::Punct(mark) if mark.as_char() == ':' && !path.is_empty() && colons < 2 => {
                    colons += 1
                }
                other => {
                    self.reference(std::mem::take(&mut path), false);
                    colons = 0;
                    match other {
                        TokenTree::Ident(name) => path.push(name.to_string()),
                        TokenTree::Group(group) => self.tokens(group.stream()),
                        _ => {}
                    }
                }
            }
        }
        self.reference(path, false);
    }
}

impl<'ast> Visit<'ast> for Reader<'_> {
    fn visit_item(&mut self, item: &'ast Item) {
        if !is_test(attributes(item)) {
            visit::visit_item(self, item);
        }
    }

    fn visit_item_mod(&mut self, item: &'ast syn::ItemMod) {
        let name = item.ident.to_string();
        let module = child(&self.module, &name);
        if let Some((_, items)) = &item.content {
            let outer = std::mem::replace(&mut self.module, module);
            let folder = self.folder.join(&name);
            let outer_folder = std::mem::replace(&mut self.folder, folder);
            self.module_items(items);
            (self.module, self.folder) = (outer, outer_folder);
            return;
        }
        let folder = self.folder.join(&name);
        let own = folder.with_extension("rs");
        let path = if own.is_file() { own } else { folder.join("mod.rs") };
        self.graph.load(&path, &folder, module, self.references);
    }

    fn visit_item_use(&mut self, item: &'ast syn::ItemUse) {
        if matches!(item.vis, Visibility::Inherited) {
            for (path, _) in flat(&item.tree, Vec::new()) {
                self.reference(path, true);
            }
        }
    }

    // The path in `pub(in path)` takes nothing from there.
    fn visit_visibility(&mut self, _: &'ast Visibility) {}

    fn visit_path(&mut self, path: &'ast syn::Path) {
        if path.leading_colon.is_none() {
            self.reference(path.segments.iter().map(|s| s.ident.to_string()).collect(), false);
        }
        visit::visit_path(self, path);
    }

    fn visit_macro(&mut self, item: &'ast syn::Macro) {
        visit::visit_macro(self, item);
        self.tokens(item.tokens.clone());
    }
}

/// The paths of a `use`, each with the name that it gets; `None` for `*`.
fn flat(tree: &UseTree, mut prefix: Vec<String>) -> Vec<(Vec<String>, Option<String>)> {
    match tree {
        UseTree::Path(path) => {
            prefix.push(path.ident.to_string());
            flat(&path.tree, prefix)
        }
        UseTree::Group(group) => group.items.iter().flat_map(|tree| flat(tree, prefix.clone())).collect(),
        UseTree::Glob(_) => vec![(prefix, None)],
        UseTree::Name(name) if name.ident == "self" => {
            let named = prefix.last().cloned();
            vec![(prefix, named)]
        }
        UseTree::Name(name) => vec![(child(&prefix, &name.ident.to_string()), Some(name.ident.to_string()))],
        UseTree::Rename(named) => {
            if named.ident != "self" {
                prefix.push(named.ident.to_string());
            }
            vec![(prefix, Some(named.rename.to_string()))]
        }
    }
}

fn defined_name(item: &Item) -> Option<String> {
    Some(match item {
        Item::Const(i) => i.ident.to_string(),
        Item::Enum(i) => i.ident.to_string(),
        Item::Fn(i) => i.sig.ident.to_string(),
        Item::Macro(i) => i.ident.as_ref()?.to_string(),
        Item::Static(i) => i.ident.to_string(),
        Item::Struct(i) => i.ident.to_string(),
        Item::Trait(i) => i.ident.to_string(),
        Item::Type(i) => i.ident.to_string(),
        Item::Union(i) => i.ident.to_string(),
        _ => return None,
    })
}

fn attributes(item: &Item) -> &[Attribute] {
    match item {
        Item::Const(i) => &i.attrs,
        Item::Enum(i) => &i.attrs,
        Item::Fn(i) => &i.attrs,
        Item::Impl(i) => &i.attrs,
        Item::Mod(i) => &i.attrs,
        Item::Static(i) => &i.attrs,
        Item::Struct(i) => &i.attrs,
        Item::Trait(i) => &i.attrs,
        Item::Type(i) => &i.attrs,
        Item::Use(i) => &i.attrs,
        _ => &[],
    }
}

/// Whether an item is only there when tests are built.
fn is_test(attributes: &[Attribute]) -> bool {
    let is =
        |a: &Attribute| a.path().is_ident("cfg") && a.parse_args::<syn::Ident>().is_ok_and(|i| i == "test");
    attributes.iter().any(is)
}
