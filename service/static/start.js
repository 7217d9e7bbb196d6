// The start page.
