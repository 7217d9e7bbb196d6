"""Everything a person looks at: tables, pictures, reports, documents. Nothing below imports it."""
