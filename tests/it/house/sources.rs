//! The project's Rust files as the rules see them: token by token, with what only tests see kept apart.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::sync::OnceLock;

use proc_macro2::{Delimiter, Ident, Spacing, TokenStream, TokenTree};

/// The member crates, in their folders under `src/`.
pub const MEMBERS: [&str; 4] = ["cancel", "formats", "signal", "geometry"];

/// One file.
pub struct Source {
    /// Its place in the repository: `src/signal/fft.rs`.
    pub file: String,
    /// Its text.
    pub text: String,
    /// Whether it holds nothing but tests, benches or their tools.
    pub is_tests: bool,
    /// Paths that it names outside of tests, `use` trees taken apart: `["crate", "store", "Shelf"]`; single words too.
    pub paths: Vec<Vec<String>>,
    /// Literals outside of tests.
    pub literals: Vec<String>,
    /// Functions, those of tests included: name and lines.
    pub functions: Vec<(String, usize)>,
    /// Names of types, functions and fields, those of tests included.
    pub names: Vec<String>,
    /// Modules in files of their own that only tests see.
    test_modules: Vec<String>,
}

/// All Rust files of the crates, of `tests/`, of `benches/` and of `python/`.
pub fn sources() -> &'static [Source] {
    static SOURCES: OnceLock<Vec<Source>> = OnceLock::new();
    SOURCES.get_or_init(|| {
        let mut files = BTreeSet::new();
        ["src", "tests", "benches", "python"].iter().for_each(|folder| walk(&root().join(folder), &mut files));
        let mut sources: Vec<Source> = files.into_iter().map(Source::read).collect();
        let test_modules: Vec<String> = sources.iter().flat_map(|source| source.test_modules.clone()).collect();
        for source in &mut sources {
            let stem = source.file.trim_end_matches(".rs");
            let within = |module: &String| stem == module || stem.starts_with(&format!("{module}/"));
            source.is_tests = !source.file.starts_with("src/") || test_modules.iter().any(within);
        }
        sources
    })
}

/// Files outside of tests whose place begins so.
pub fn code(folder: &'static str) -> impl Iterator<Item = &'static Source> {
    sources().iter().filter(move |source| source.file.starts_with(folder) && !source.is_tests)
}

/// The repository.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn walk(folder: &Path, files: &mut BTreeSet<String>) {
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() && entry.file_name() != "target" {
            walk(&path, files);
        } else if path.extension().is_some_and(|extension| extension == "rs") {
            files.insert(path.strip_prefix(root()).unwrap().to_string_lossy().replace('\\', "/"));
        }
    }
}

impl Source {
    fn read(file: String) -> Self {
        let text = fs::read_to_string(root().join(&file)).unwrap();
        let tokens: TokenStream = text.parse().unwrap_or_else(|error| panic!("{file}: {error}"));
        let mut source = Self {
            file,
            text,
            is_tests: false,
            paths: Vec::new(),
            literals: Vec::new(),
            functions: Vec::new(),
            names: Vec::new(),
            test_modules: Vec::new(),
        };
        source.take(tokens, false);
        source
    }

    /// The member crate that it belongs to.
    pub fn member(&self) -> Option<&'static str> {
        MEMBERS.into_iter().find(|member| self.file.starts_with(&format!("src/{member}/")))
    }

    /// Its module within its crate: `["sparse", "place"]`; nothing for the crate's root.
    pub fn module(&self) -> Vec<&str> {
        let folder = self.member().map_or("src/".to_owned(), |member| format!("src/{member}/"));
        let place = self.file.trim_start_matches(&folder).trim_end_matches(".rs");
        let mut module: Vec<&str> = place.split('/').collect();
        if module.last().is_some_and(|last| ["mod", "lib"].contains(last)) {
            module.pop();
        }
        module
    }

    /// What it imports from its own crate, from the crate's root: `["store", "Shelf"]`.
    pub fn imports(&self) -> impl Iterator<Item = Vec<&str>> {
        self.paths.iter().filter_map(|path| {
            let supers = path.iter().take_while(|part| *part == "super").count();
            let rest = path[supers..].iter().map(String::as_str);
            let module = self.module();
            match path[0].as_str() {
                "crate" => Some(rest.skip(1).collect()),
                "super" => Some(module[..module.len().saturating_sub(supers)].iter().copied().chain(rest).collect()),
                _ => None,
            }
        })
    }

    fn take(&mut self, tokens: TokenStream, in_tests: bool) {
        let tokens: Vec<TokenTree> = tokens.into_iter().collect();
        let mut rest = &tokens[..];
        while let Some(token) = rest.first() {
            let is_test = is_test_attribute(rest);
            let length = if is_test { item(rest) } else { 1 };
            if is_test {
                self.test_modules.extend(module_of_tests(&self.file, &rest[..length]));
                self.take(rest[2..length].iter().cloned().collect(), true);
            } else {
                self.declare(rest);
                match token {
                    TokenTree::Group(group) => self.take(group.stream(), in_tests),
                    TokenTree::Literal(literal) if !in_tests => self.literals.push(literal.to_string()),
                    TokenTree::Ident(_) if !in_tests => {
                        let length = path(rest, &[], &mut self.paths);
                        rest = &rest[length - 1..];
                    }
                    _ => {}
                }
            }
            rest = &rest[length..];
        }
    }

    /// What a function, type or field declares that begins here.
    fn declare(&mut self, tokens: &[TokenTree]) {
        let [TokenTree::Ident(keyword), TokenTree::Ident(name), ..] = tokens else { return };
        match keyword.to_string().as_str() {
            "fn" => {
                if let Some(TokenTree::Group(body)) = tokens.iter().find(|token| is_brace(token) || is(token, ';')) {
                    let lines = body.span_close().end().line - keyword.span().start().line + 1;
                    self.functions.push((name.to_string(), lines));
                }
            }
            "struct" | "enum" => {
                if let Some(TokenTree::Group(body)) = tokens.iter().find(|token| is_brace(token) || is(token, ';')) {
                    fields(body.stream(), &mut self.names);
                }
            }
            "trait" | "type" => {}
            _ => return,
        }
        self.names.push(name.to_string());
    }
}

/// Takes down the path that begins here, behind `prefix`; gives its length in tokens.
fn path(tokens: &[TokenTree], prefix: &[String], paths: &mut Vec<Vec<String>>) -> usize {
    let mut path = prefix.to_vec();
    let mut at = 0;
    while let Some(TokenTree::Ident(part)) = tokens.get(at) {
        path.push(part.to_string());
        at += 1;
        if !(tokens.get(at).is_some_and(|token| is(token, ':')) && tokens.get(at + 1).is_some_and(|t| is(t, ':'))) {
            break;
        }
        match tokens.get(at + 2) {
            Some(TokenTree::Ident(_)) => at += 2,
            Some(TokenTree::Group(tree)) if tree.delimiter() == Delimiter::Brace => {
                use_tree(tree.stream(), &path, paths);
                return at + 3;
            }
            _ => break,
        }
    }
    paths.push(path);
    at
}

/// The members of a `use` tree: `{a::b, c}`.
fn use_tree(tree: TokenStream, prefix: &[String], paths: &mut Vec<Vec<String>>) {
    let tokens: Vec<TokenTree> = tree.into_iter().collect();
    for member in tokens.split(|token| is(token, ',')).filter(|member| !member.is_empty()) {
        path(member, prefix, paths);
    }
}

/// Names of the fields in the body of a type.
fn fields(body: TokenStream, names: &mut Vec<String>) {
    let tokens: Vec<TokenTree> = body.into_iter().collect();
    for (i, token) in tokens.iter().enumerate() {
        match (token, tokens.get(i + 1)) {
            (TokenTree::Group(variant), _) if is_brace(token) => fields(variant.stream(), names),
            (TokenTree::Ident(name), Some(TokenTree::Punct(colon)))
                if colon.as_char() == ':' && is_field(name, colon.spacing(), &tokens[..i]) =>
            {
                names.push(name.to_string());
            }
            _ => {}
        }
    }
}

/// Whether a name before a colon is a field's: not a part of a path.
fn is_field(name: &Ident, colon: Spacing, before: &[TokenTree]) -> bool {
    colon == Spacing::Alone && name != "self" && !before.last().is_some_and(|token| is(token, ':'))
}

/// Whether `#[cfg(test)]` begins here.
fn is_test_attribute(tokens: &[TokenTree]) -> bool {
    let [hash, TokenTree::Group(attribute), ..] = tokens else { return false };
    is(hash, '#') && attribute.to_string().replace(' ', "") == "[cfg(test)]"
}

/// Length in tokens of the item that begins here, its attributes included.
fn item(tokens: &[TokenTree]) -> usize {
    let ends = |at: usize| is(&tokens[at], ';') || (is_brace(&tokens[at]) && !is(&tokens[at - 1], ':'));
    (1..tokens.len()).find(|&at| ends(at)).map_or(tokens.len(), |at| at + 1)
}

/// The module, as a place without extension, that an item declares in a file of its own.
fn module_of_tests(file: &str, item: &[TokenTree]) -> Option<String> {
    let [.., TokenTree::Ident(keyword), TokenTree::Ident(name), end] = item else { return None };
    let (folder, stem) = file.trim_end_matches(".rs").rsplit_once('/')?;
    let folder = if ["mod", "lib", "main"].contains(&stem) { folder.to_owned() } else { format!("{folder}/{stem}") };
    (keyword == "mod" && is(end, ';')).then(|| format!("{folder}/{name}"))
}

fn is(token: &TokenTree, character: char) -> bool {
    matches!(token, TokenTree::Punct(punct) if punct.as_char() == character)
}

fn is_brace(token: &TokenTree) -> bool {
    matches!(token, TokenTree::Group(group) if group.delimiter() == Delimiter::Brace)
}
