-- How far every patch lies from points that were measured by other means: a table `name, x_m, y_m, z_m` (CSV or Parquet) in the frame of
-- `patches`. The nearest point of each patch, the distance, and its standard deviation (that of the patch along the line between them).
SET VARIABLE results = 'results';
SET VARIABLE points = 'points.csv';

WITH apart AS (
    SELECT p.*, q.name AS point, p.x_m - q.x_m AS dx, p.y_m - q.y_m AS dy, p.z_m - q.z_m AS dz
    FROM read_parquet(getvariable('results') || '/patches/*.parquet') p, read_csv(getvariable('points')) q
    WHERE p.alternative = 0
)
SELECT patch, kind, point, sqrt(dx ** 2 + dy ** 2 + dz ** 2) AS distance_m,
    sqrt((dx ** 2 * cov_xx_m2 + dy ** 2 * cov_yy_m2 + dz ** 2 * cov_zz_m2
        + 2 * (dx * dy * cov_xy_m2 + dx * dz * cov_xz_m2 + dy * dz * cov_yz_m2)) / (dx ** 2 + dy ** 2 + dz ** 2)) AS sd_m
FROM apart
QUALIFY row_number() OVER (PARTITION BY patch ORDER BY distance_m) = 1
ORDER BY patch;
