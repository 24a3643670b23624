//! stub until written
use super::Page;
/// page
pub fn page(page: &Page) -> String {
    page.title.clone()
}
