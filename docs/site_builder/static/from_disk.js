// A browser lets no page opened from the disk read other files: found pages are listed by title then, without excerpts.
if (location.protocol === "file:") {
  DOCUMENTATION_OPTIONS.SHOW_SEARCH_SUMMARY = false;
}
