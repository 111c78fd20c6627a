//! Makes the plotting script that every page carries: Plotly.js as the `plotly` crate has it (MIT licence, the notices
//! stay in it), less the modules that lines and points do not need. Of 4.7 MB one remains, and compressed half of one.

#[path = "src/packed.rs"]
mod packed;

use std::collections::{HashMap, HashSet};
use std::path::Path;

/// The bundler's helper, whose name stands before it: a module is a function that runs when it is first asked for.
const HELPER: &str = "=(e,t)=>()=>(t||e((t={exports:{}}).exports,t),t.exports)";
/// The entry registers all kinds of plots beside that of lines, which the core has.
const KINDS: (&str, &str) = (".register([", "])");
/// The only one of them that pages need beside lines, for spectrograms: how its module names itself.
const HEATMAP: &str = "name:\"heatmap\"";

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=src/packed.rs");
    let script = plotly();
    let needed = without_unused_modules(&script)
        .expect("Plotly.js must be bundled as in version 3.0.1; look at build.rs before taking another one");
    let folder = std::env::var_os("OUT_DIR").expect("cargo names a folder for what is built");
    std::fs::write(Path::new(&folder).join("plotly.txt"), packed::packed(&needed))
        .expect("the folder for what is built can be written");
}

/// The text of the first script element: the second one is MathJax, and no formula is drawn.
fn plotly() -> String {
    let elements = plotly::Plot::offline_js_sources();
    let start = elements.find('>').map_or(0, |i| i + 1);
    let end = elements.find("</script>").unwrap_or(elements.len());
    elements[start..end].to_string()
}

/// The bundle with no kind of plot registered but lines and heat maps, and of its modules only those that can still be
/// asked for.
///
/// A module counts as asked for wherever its name stands, though it may be the name of something else: that keeps too
/// many rather than too few.
fn without_unused_modules(script: &str) -> Option<String> {
    let helper = script[..script.find(HELPER)?].rsplit(|c| !in_name(c)).next()?;
    let opening = format!("={helper}(");
    let starts: Vec<(usize, &str)> = script
        .match_indices(&opening)
        .filter_map(|(at, _)| {
            let name = script[..at].rsplit(|c| !in_name(c)).next()?;
            let start = at - name.len();
            script[..start].ends_with("var ").then_some((start - "var ".len(), name))
        })
        .collect();
    let (first, (last, entry)) = (starts.first()?.0, *starts.last()?);
    let ends = starts.iter().skip(1).map(|(at, _)| *at);
    let mut modules: HashMap<&str, &str> =
        starts.iter().zip(ends).map(|((at, name), end)| (*name, &script[*at..end])).collect();

    let (head, kinds) = script[last..].split_once(KINDS.0)?;
    let (kinds, tail) = kinds.split_once(KINDS.1)?;
    // The entry registers a wrapper of the module.
    let heatmap = *modules.iter().find(|(_, module)| module.contains(HEATMAP))?.0;
    let wraps = |kind: &str| modules.get(kind).is_some_and(|m| m.contains(&format!("={heatmap}()")));
    let kept = kinds.split(',').find(|kind| wraps(kind.trim_end_matches("()")))?;
    let end = [head, KINDS.0, kept, KINDS.1, tail].concat();
    modules.insert(entry, &end);

    let mut needed: HashSet<&str> = HashSet::from([entry]);
    let mut unread = vec![&script[..first], end.as_str()];
    while let Some(text) = unread.pop() {
        for name in text.split(|c| !in_name(c)) {
            if let Some(module) = modules.get(name)
                && needed.insert(name)
            {
                unread.push(module);
            }
        }
    }
    let parts = starts.iter().filter(|(_, name)| needed.contains(name)).map(|(_, name)| modules[name]);
    Some(script[..first].to_string() + &parts.collect::<String>())
}

/// True for a character of a name in JavaScript, as the bundler makes them.
fn in_name(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_' || c == '$'
}
