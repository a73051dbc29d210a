"""The figures of the report, one function each: results in, pictures, tables, comparisons out."""
