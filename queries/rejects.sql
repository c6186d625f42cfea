-- What was rejected, and why: reasons that differ only in numbers are one kind; one example of each with its file.
SET VARIABLE results = 'results';

SELECT stage, regexp_replace(reason, '[0-9]+', '#', 'g') AS kind,
    count(*) AS records,
    min(coalesce(file, '')) AS first_file,
    min(reason) AS example
FROM read_parquet(getvariable('results') || '/rejects/*.parquet')
GROUP BY ALL
ORDER BY records DESC, stage, kind;
