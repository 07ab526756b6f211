"""The claims, a module a topic; :mod:`validation.claim_table` lists them all."""
