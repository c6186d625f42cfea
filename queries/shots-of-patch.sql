-- Which shots made this patch: the exposures behind every onset that its position rests on, with file and segment.
-- Needs the table `traces`, an index or with its codes. `periscope explain RESULTS patch=3` says the same and more.
SET VARIABLE results = 'results';
SET VARIABLE patch = 3;

WITH captures AS (
    SELECT DISTINCT campaign, sensor, lit, seen
    FROM read_parquet(getvariable('results') || '/patches.residuals/*.parquet')
    WHERE used AND list_contains(path, getvariable('patch'))
)
SELECT campaign, sensor, lit, seen, shot, is_reference, file, segment, acquired_at
FROM read_parquet(getvariable('results') || '/traces/*.parquet') JOIN captures USING (campaign, sensor, lit, seen)
WHERE role = 'scene'
ORDER BY campaign, sensor, lit, seen, shot, is_reference;
