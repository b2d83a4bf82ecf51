//! The page of `bvh-compare --html`, read as a browser reads it: by a tokenizer that follows the standard.

mod compare_support;

use compare_support::cli::*;
use compare_support::files::*;
use embree_trace::format::bvh::fingerprint;
use html5gum::{StartTag, Token, Tokenizer};
use std::collections::HashSet;

/// What a page consists of.
#[derive(Default)]
struct Page {
    tags: Vec<(String, Vec<(String, String)>)>,
    /// Of everything but style.
    text: String,
    style: String,
}

/// Elements without an end.
const VOID: [&str; 5] = ["meta", "img", "br", "hr", "link"];

impl Page {
    /// Every error of the tokenizer, and every element that is not closed where it should be, fails.
    fn parse(html: &str) -> Page {
        let string = |bytes: &[u8]| String::from_utf8(bytes.to_vec()).expect("UTF-8");
        let mut page = Page::default();
        let mut open: Vec<String> = Vec::new();
        for token in Tokenizer::new(html) {
            match token.expect("reading from memory") {
                Token::StartTag(StartTag { name, attributes, self_closing, .. }) => {
                    let name = string(&name);
                    let attributes =
                        attributes.iter().map(|(key, value)| (string(key), string(value))).collect();
                    if !VOID.contains(&name.as_str()) && !self_closing {
                        open.push(name.clone());
                    }
                    page.tags.push((name, attributes));
                }
                Token::EndTag(tag) => assert_eq!(open.pop(), Some(string(&tag.name)), "elements nest"),
                Token::String(text) => {
                    let style = open.last().is_some_and(|name| name == "style");
                    if style { &mut page.style } else { &mut page.text }.push_str(&string(&text));
                }
                Token::Error(error) => panic!("{error:?}"),
                Token::Comment(_) => panic!("a comment is of no use to a reader"),
                Token::Doctype(_) => assert!(page.tags.is_empty()),
            }
        }
        assert!(open.is_empty(), "{open:?} stay open");
        page
    }

    fn all<'a>(&'a self, attribute: &'a str) -> impl Iterator<Item = &'a str> {
        let attributes = self.tags.iter().flat_map(|(_, attributes)| attributes);
        attributes.filter(move |(key, _)| key == attribute).map(|(_, value)| value.as_str())
    }

    fn count(&self, tag: &str) -> usize {
        self.tags.iter().filter(|(name, _)| name == tag).count()
    }
}

fn page(files: &Files, arguments: &[&str], code: i32) -> (String, Page) {
    let output = files.run(&[arguments, &["--html", "report.html"]].concat());
    assert_eq!(output.status.code(), Some(code), "{}", text(&output.stderr));
    let html = String::from_utf8(files.read("report.html")).expect("UTF-8");
    let page = Page::parse(&html);
    (html, page)
}

#[test]
fn a_page_holds_everything_and_needs_nothing() {
    let files = Files::new();
    let (others, rejects) = records(&files.triangles, 1000, 77);
    files.write("other.rays", &rays_bytes(fingerprint(&files.triangles), &others, &rejects, 300));
    let (html, page) = page(&files, &["four.bvh", "two.bvh", "eight.bvh", "casts.rays", "other.rays"], 0);

    for part in [
        "four against two, eight",
        "Every answer agrees",
        "Cost per query",
        "By kind, depth and purpose",
        "Distribution",
        "Where in the tree",
        "Where in the image",
        "What was compared",
        "Words",
        "a test",
        "UTC",
        "processors",
        "casts.rays other.rays --html report.html",
        "\"image\"",
        &format!("{:016x}", fingerprint(&files.triangles)),
        "3,000 queries",
        "1,000 queries",
    ] {
        assert!(page.text.contains(part), "{part}");
    }
    // The contents lead to every part, and every part is there once.
    let ids: Vec<&str> = page.all("id").collect();
    assert_eq!(ids.iter().collect::<HashSet<_>>().len(), ids.len());
    let links: HashSet<&str> = page.all("href").collect();
    for link in &links {
        assert!(link.strip_prefix('#').is_some_and(|id| ids.contains(&id)), "{link}");
    }
    for id in ids.iter().filter(|id| **id != "main") {
        assert!(links.contains(format!("#{id}").as_str()), "nothing leads to {id}");
    }
    // Per recording and order: bars, a histogram, two charts by level; pictures of 3 trees and 2 differences.
    let charts = page.all("class").filter(|class| *class == "chart").count();
    assert_eq!(charts, 2 * 2 * 4);
    assert_eq!(page.count("img"), 2 * 2 * (3 + 2));
    assert!(page.all("src").all(|source| source.starts_with("data:image/png;base64,")));
    assert_eq!(page.all("alt").count(), page.count("img"));
    assert_eq!(page.count("script") + page.count("link") + page.count("iframe"), 0);
    assert!(!page.style.contains("url(") && !page.style.contains("@import"));
    assert!(!html.contains("://"), "an address");
    assert!(html.len() < 1_000_000, "{} bytes", html.len());
}

#[test]
fn names_from_files_stay_text() {
    let files = Files::new();
    let hostile = "<script>alert(1)</script> & \"x' onload=.bvh";
    let meta = "{\"image\":[16,12],\"recipe\":\"</pre><img src=x onerror=alert(2)>\"}";
    files.write(hostile.replace('/', "\u{2215}").as_str(), &bvh_bytes(&files.triangles, 2, 1, 1, Some(meta)));
    let hostile = &hostile.replace('/', "\u{2215}");
    let (html, page) = page(&files, &["two.bvh", hostile, "casts.rays", "--traversal", "odf"], 0);
    assert!(page.text.contains(hostile.as_str()));
    assert!(page.text.contains("onerror=alert(2)"));
    assert_eq!(page.count("script"), 0);
    assert_eq!(page.all("onload").count() + page.all("onerror").count(), 0);
    assert!(!html.contains("<script") && !html.contains("<img src=x"));
}

#[test]
fn a_page_without_pictures_or_with_failures_says_so() {
    let files = Files::new();
    let (_, plain) = page(&files, &["two.bvh", "casts.rays", "--traversal", "ray-order"], 0);
    assert_eq!(plain.count("img"), 0);
    assert!(plain.text.contains("--size WxH"));
    let limit = ["eight.bvh", "two.bvh", "casts.rays", "--traversal", "odf", "--fail-above", "0.1"];
    let (_, failed) = page(&files, &limit, 1);
    assert!(failed.text.contains("The comparison failed.") && failed.text.contains("above 0.1"));
    files.refused(&["two.bvh", "casts.rays", "--html", "no/such/folder.html"], &["no/such/folder.html"]);
}

#[test]
fn large_pictures_are_reduced_and_it_says_so() {
    let files = Files::new();
    let (html, page) =
        page(&files, &["two.bvh", "casts.rays", "--traversal", "odf", "--size", "5000x3000"], 0);
    assert!(page.text.contains("Reduced from 5000 × 3000"));
    assert!(html.len() < 6_000_000, "{} bytes", html.len());
}
