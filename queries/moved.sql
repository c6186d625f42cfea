-- What moved between two analyses of one scene? Distances do not depend on the frame, which a patch that moves may turn. Of a patch that moved
-- most distances change; of the others only those to it. Patch 0 is laser and sensor. The first row moved, if its share is far above the others'.
SET VARIABLE results = 'results';
SET VARIABLE earlier = 'earlier-results';

WITH pairs AS (
    SELECT a, b, now.distance_m - before.distance_m AS change_m, sqrt(now.sd_m ** 2 + before.sd_m ** 2) AS sd_m
    FROM read_parquet(getvariable('results') || '/distances/*.parquet') now
    JOIN read_parquet(getvariable('earlier') || '/distances/*.parquet') before USING (a, b)
), ends AS (
    SELECT a AS patch, * FROM pairs UNION ALL SELECT b, * FROM pairs
)
SELECT patch, count(*) AS distances,
    count(*) FILTER (abs(change_m) > 4 * sd_m) AS changed,
    max(abs(change_m)) AS most_m,
    sqrt(avg((change_m / sd_m) ** 2)) AS rms_in_sd
FROM ends GROUP BY patch
ORDER BY rms_in_sd DESC;
