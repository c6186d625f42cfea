"""Prints the answer of a recipe as JSON: python recipes.py RECIPE [NAME=VALUE ...]"""

import json
import re
import runpy
import sys

path, *pairs = sys.argv[1:]
values = dict(pair.split("=", 1) for pair in pairs)
if path.endswith(".sql"):
    import duckdb

    sql = open(path).read()
    for name, value in values.items():
        line = f"SET VARIABLE {name} = {value if value.isdigit() else repr(value)};"
        sql, count = re.subn(rf"(?m)^SET VARIABLE {name} = .*;$", lambda _: line, sql)
        assert count == 1, f"{path} has no variable {name}"
    answer = duckdb.execute(sql)
    names = [column[0] for column in answer.description]
    rows = [dict(zip(names, row)) for row in answer.fetchall()]
else:
    rows = runpy.run_path(path)["answer"](**values).to_dicts()
json.dump(rows, sys.stdout)
