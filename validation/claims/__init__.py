"""The claims, a module a topic; :mod:`validation.claims.table` lists them all."""
