from gsgen.contract import validate

report = validate(3)
print(report.no_such_field)
